import * as flatbuffers from "flatbuffers";
import { kNone } from "./surface";
import { Body } from "./wire/incise/wire/body";
import { Message } from "./wire/incise/wire/message";
import { SurfaceAsset as WireAsset } from "./wire/incise/wire/surface-asset";

const kMaxSteps = 16; // a face spans few triangles

export interface Material {
  name: string;
  diffuse: [number, number, number];
  texture: string; // its name below the asset's path; empty: none
}

/** The weights of a triangle's corners (9 numbers from p[at] on) that give the point of its plane nearest to (x, y, z). */
function barycentric(p: Float64Array, at: number, x: number, y: number, z: number, out: Float64Array): void {
  const ux = p[at + 3] - p[at],
    uy = p[at + 4] - p[at + 1],
    uz = p[at + 5] - p[at + 2];
  const vx = p[at + 6] - p[at],
    vy = p[at + 7] - p[at + 1],
    vz = p[at + 8] - p[at + 2];
  const wx = x - p[at],
    wy = y - p[at + 1],
    wz = z - p[at + 2];
  const nx = uy * vz - uz * vy,
    ny = uz * vx - ux * vz,
    nz = ux * vy - uy * vx;
  const area = nx * nx + ny * ny + nz * nz;
  out[1] = ((wy * vz - wz * vy) * nx + (wz * vx - wx * vz) * ny + (wx * vy - wy * vx) * nz) / area;
  out[2] = ((uy * wz - uz * wy) * nx + (uz * wx - ux * wz) * ny + (ux * wy - uy * wx) * nz) / area;
  out[0] = 1 - out[1] - out[2];
}

/** The surface that the body was filled from: its texture on the cut body (PROTOCOL.md, section 5). */
export class SurfaceAsset {
  readonly uvs: Float32Array; // u v by corner; empty: none
  readonly materialOf: Uint32Array; // by triangle; empty: none
  readonly materials: Material[] = [];
  private readonly corners: Float64Array; // 9 numbers a triangle
  private readonly beside: Uint32Array; // by corner: the triangle across the edge opposite to it; kNone: a seam
  private readonly weights = new Float64Array(3);

  /** Of the bytes that the server's HTTP port answers. Throws an Error. */
  constructor(bytes: Uint8Array) {
    const buffer = new flatbuffers.ByteBuffer(bytes);
    if (bytes.length < 16 || !Message.bufferHasIdentifier(buffer))
      throw new Error("bytes that are no message of incise");
    const message = Message.getRootAsMessage(buffer);
    if (message.bodyType() !== Body.SurfaceAsset) throw new Error("a message of another kind");
    const wire: WireAsset = message.body(new WireAsset());
    const positions = wire.positionsArray() ?? new Float64Array(0);
    const triangles = wire.trianglesArray() ?? new Uint32Array(0);
    this.uvs = wire.uvsArray() ?? new Float32Array(0);
    this.materialOf = wire.materialIndicesArray() ?? new Uint32Array(0);
    for (let i = 0; i < wire.materialsLength(); ++i) {
      const material = wire.materials(i)!;
      const diffuse = material.diffuseArray() ?? [0.8, 0.8, 0.8];
      this.materials.push({
        name: material.name() ?? "",
        diffuse: [diffuse[0], diffuse[1], diffuse[2]],
        texture: material.texture() ?? "",
      });
    }
    const n = triangles.length / 3;
    const fits = (array: ArrayLike<number>, count: number) => array.length === 0 || array.length === count;
    if (!fits(this.uvs, 6 * n) || !fits(this.materialOf, n) || triangles.some((v) => 3 * v + 2 >= positions.length))
      throw new Error("arrays that do not fit each other");
    this.corners = new Float64Array(9 * n);
    for (let c = 0; c < 3 * n; ++c)
      for (let i = 0; i < 3; ++i) this.corners[3 * c + i] = positions[3 * triangles[c] + i];
    this.beside = this.neighbours(triangles);
  }

  private neighbours(triangles: Uint32Array): Uint32Array {
    const beside = new Uint32Array(triangles.length).fill(kNone);
    const corner = (c: number, step: number) => c - (c % 3) + ((c + step) % 3);
    const waiting = new Map<string, number>();
    const end = (c: number) => {
      const uv = this.uvs.length > 0 ? `,${this.uvs[2 * c]},${this.uvs[2 * c + 1]}` : "";
      return triangles[c] + uv;
    };
    for (let c = 0; c < triangles.length; ++c) {
      const ends = [end(corner(c, 1)), end(corner(c, 2))].sort();
      const key = `${ends.join(";")};${this.materialOf[(c / 3) | 0] ?? 0}`;
      const other = waiting.get(key);
      if (other === undefined) {
        waiting.set(key, c);
        continue;
      }
      waiting.delete(key);
      beside[c] = (other / 3) | 0;
      beside[other] = (c / 3) | 0;
    }
    return beside;
  }

  /**
   * Where a point of the body at rest is: a triangle; the weights of its corners are in `weights`. Begins in `origin`, and goes on
   * across the edge that the point is farthest beyond, but across no seam.
   */
  private find(origin: number, x: number, y: number, z: number): number {
    const w = this.weights;
    let at = origin,
      before = kNone;
    barycentric(this.corners, 9 * at, x, y, z, w);
    for (let step = 0; step < kMaxSteps; ++step) {
      const least = w[0] <= w[1] && w[0] <= w[2] ? 0 : w[1] <= w[2] ? 1 : 2;
      const next = this.beside[3 * at + least];
      if (w[least] >= 0 || next === kNone || next === before) break;
      before = at;
      at = next;
      barycentric(this.corners, 9 * at, x, y, z, w);
    }
    return at;
  }

  /**
   * Writes u and v of a face's three corners, whose places in the body at rest are 9 numbers, to out[at], `stride` apart. False: the face has no
   * origin, or the surface no texture coordinates.
   */
  cornerUvs(origin: number, rest: ArrayLike<number>, out: Float32Array, at = 0, stride = 2): boolean {
    if (this.uvs.length === 0 || 3 * origin >= this.beside.length) return false;
    for (let k = 0; k < 3; ++k) {
      const corner = 3 * this.find(origin, rest[3 * k], rest[3 * k + 1], rest[3 * k + 2]);
      for (let i = 0; i < 2; ++i) {
        let sum = 0;
        for (let j = 0; j < 3; ++j) sum += this.weights[j] * this.uvs[2 * (corner + j) + i];
        out[at + stride * k + i] = sum;
      }
    }
    return true;
  }
}
