import * as THREE from "three";
import type { Corners } from "./corner_buffers";
import type { ShownTriangles } from "./section_lines";
import { BodyLook, layeredTexture } from "./body_look";
import { bodyFragmentShader, bodyVertexShader } from "./body_shader";
import type { Look } from "./look_source";
import { kNone } from "./surface";

const kPieceColumns = 256;
const kHeldNear = 0.012, // times the body's size
  kHeldLips = 0.09,
  kHeldPieces = 0.4;
const kNotHeld = [1, 1] as const;
const kMostRanges = 24; // uploads a buffer; more and larger gaps between slots are uploaded as well

export type Colouring = "tissue" | "pieces" | "quality";

/** Ranges [begin, end) that cover these ascending slots. Gaps are filled until there are at most kMostRanges. */
export function rangesOf(slots: Uint32Array): [number, number][] {
  for (let gap = 8; ; gap *= 4) {
    const ranges: [number, number][] = [];
    for (const slot of slots) {
      const last = ranges[ranges.length - 1];
      if (last && slot - last[1] <= gap) last[1] = slot + 1;
      else ranges.push([slot, slot + 1]);
    }
    if (ranges.length <= kMostRanges) return ranges;
  }
}

/** The body on the graphics card: three corners a slot, not indexed, changed in place. */
export class BodyMesh {
  readonly mesh: THREE.Mesh<THREE.BufferGeometry, THREE.ShaderMaterial>;
  readonly positions: () => Float32Array;
  /** The half-face of each slot, or kNone. */
  ids = new Uint32Array(0);
  /** Slots that hold a triangle or have held one. */
  slots = 0;
  /** Grows with each change of what is drawn. */
  version = 0;
  readonly look = new BodyLook();
  private showsImage = false;
  private hasRegions = false; // the geometry has
  private pieceOffsets = new Float32Array(4 * kPieceColumns);
  private pieceTexture = this.makePieceTexture(1);

  constructor() {
    const material = new THREE.ShaderMaterial({
      glslVersion: THREE.GLSL3,
      vertexShader: bodyVertexShader,
      fragmentShader: bodyFragmentShader,
      defines: {
        COLOURING: 0,
        WIRE: 0,
        INSIDE: 1,
        SECTION: 0,
        DETAIL: 1,
        TEXTURE: 0,
        REST: 0,
        IMAGE: 0,
        REGIONS: 0,
        REGION_IMAGE: 0,
        REGION_TEXTURES: 0,
      },
      side: THREE.DoubleSide,
      uniforms: {
        uOpen: { value: 0 },
        uHeldAt: { value: new THREE.Vector3() },
        uHeldAlong: { value: new THREE.Vector3() },
        uHeld: { value: new THREE.Vector4() },
        uPieces: { value: this.pieceTexture },
        uGrain: { value: 20 },
        uSection: { value: new THREE.Vector4(0, 0, 0, 1) },
        uLight: { value: new THREE.Vector3(0, 0, 1) },
        uFill: { value: new THREE.Vector3(0, 0, 1) },
        uAmbient: { value: 1 },
        uTexture: { value: null },
        ...this.look.uniforms,
      },
    });
    this.mesh = new THREE.Mesh(new THREE.BufferGeometry(), material);
    this.mesh.frustumCulled = false;
    this.mesh.visible = false;
    this.positions = () => (this.mesh.geometry.getAttribute("position")?.array as Float32Array) ?? new Float32Array(0);
  }

  get uniforms() {
    return this.mesh.material.uniforms;
  }

  /** Replaces everything; the buffers have room for `capacity` slots. */
  replace(slots: number, capacity: number, corners: Corners): void {
    const geometry = new THREE.BufferGeometry();
    const add = (
      name: string,
      Type: typeof Float32Array | typeof Int16Array | typeof Uint8Array,
      size: number,
      normalised: boolean,
      from?: ArrayLike<number>,
    ) => {
      const array = new Type(3 * size * capacity);
      if (from) array.set(from);
      const attribute = new THREE.BufferAttribute(array, size, normalised);
      attribute.setUsage(THREE.DynamicDrawUsage);
      geometry.setAttribute(name, attribute);
    };
    add("position", Float32Array, 3, false, corners.positions);
    add("aNormal", Int16Array, 4, true, corners.normals);
    add("aFacts", Uint8Array, 4, false, corners.facts);
    add("aLips", Float32Array, 3, false);
    const textured = corners.texture.length > 0 && this.uniforms.uTexture.value !== null;
    if (textured) add("aTexture", Float32Array, 3, false, corners.texture);
    this.define("TEXTURE", Number(textured));
    if (corners.rest.length > 0) add("aRest", Float32Array, 3, false, corners.rest);
    this.define("REST", Number(corners.rest.length > 0));
    if (corners.regions.length > 0) add("aRegion", Float32Array, 1, false, corners.regions);
    this.hasRegions = corners.regions.length > 0;
    this.defineLook();
    geometry.setDrawRange(0, 3 * slots);
    this.mesh.geometry.dispose();
    this.mesh.geometry = geometry;
    this.mesh.visible = slots > 0;
    this.ids = new Uint32Array(capacity).fill(kNone);
    this.ids.set(corners.ids);
    this.slots = slots;
    ++this.version;
  }

  patch(slots: Uint32Array, highest: number, corners: Corners): void {
    const ranges = rangesOf(slots);
    for (let i = 0; i < slots.length; ++i) this.ids[slots[i]] = corners.ids[i];
    this.write("position", 9, corners.positions, slots, ranges);
    this.write("aNormal", 12, corners.normals, slots, ranges);
    this.write("aFacts", 12, corners.facts, slots, ranges);
    if (this.mesh.material.defines.REST) this.write("aRest", 9, corners.rest, slots, ranges);
    if (this.hasRegions) this.write("aRegion", 3, corners.regions, slots, ranges);
    if (this.mesh.material.defines.TEXTURE) this.write("aTexture", 9, corners.texture, slots, ranges);
    this.slots = Math.max(this.slots, highest);
    this.mesh.geometry.setDrawRange(0, 3 * this.slots);
    ++this.version;
  }

  /** The layers that corners of the next geometry refer to; sRGB, 4 bytes a pixel, the lowest row first. */
  setTexture(size: number, layers: number, pixels: Uint8Array<ArrayBuffer>): void {
    this.uniforms.uTexture.value?.dispose();
    this.uniforms.uTexture.value = layeredTexture({ size, layers, pixels });
  }

  /** How regions look and what is inside, from here on. */
  setLook(look: Look): void {
    this.look.set(look);
    this.defineLook();
    ++this.version;
  }

  /** On cut faces and in the section: the volume image, or tissue. */
  showImage(on: boolean): void {
    this.showsImage = on;
    this.defineLook();
  }

  private defineLook(): void {
    const regions = this.hasRegions && this.look.hasRegions;
    this.define("IMAGE", Number(this.showsImage && this.look.hasImage));
    this.define("REGIONS", Number(regions));
    this.define("REGION_IMAGE", Number(regions && this.look.hasRegionImage));
    this.define("REGION_TEXTURES", Number(regions && this.look.hasTextures));
  }

  /** lips: 3 numbers a corner, from slot 0 on; pieces: 4 numbers a row. */
  setOpening(lips: Float32Array, pieces: Float32Array): void {
    const attribute = this.mesh.geometry.getAttribute("aLips") as THREE.BufferAttribute | undefined;
    if (!attribute) return;
    const count = Math.min(lips.length, attribute.array.length);
    (attribute.array as Float32Array).set(lips.subarray(0, count));
    attribute.addUpdateRange(0, count);
    attribute.needsUpdate = true;
    const rows = Math.ceil(pieces.length / 4 / kPieceColumns) || 1;
    if (rows > this.pieceTexture.image.height) {
      this.pieceTexture.dispose();
      this.pieceTexture = this.makePieceTexture(rows);
      this.uniforms.uPieces.value = this.pieceTexture;
    }
    this.pieceOffsets.set(pieces);
    this.pieceTexture.needsUpdate = true;
    ++this.version;
  }

  /** 9 numbers for each triangle that is drawn. */
  drawnTriangles(): Float32Array {
    const p = this.positions();
    const out: number[] = [];
    for (let i = 0; i < 9 * this.slots; i += 9) {
      if (p.subarray(i, i + 9).some((x) => x !== 0)) out.push(...p.subarray(i, i + 9));
    }
    return Float32Array.from(out);
  }

  setColouring(colouring: Colouring): void {
    this.define("COLOURING", { tissue: 0, pieces: 1, quality: 2 }[colouring]);
  }

  setWire(on: boolean): void {
    this.define("WIRE", Number(on));
  }

  /** The plane of a section, (normal, offset): points with normal . p > offset are left out. Null: none. */
  setSection(plane: readonly number[] | null): void {
    this.uniforms.uSection.value.fromArray(plane ?? [0, 0, 0, 1]);
    this.define("SECTION", Number(plane !== null));
  }

  /** From here on nothing is opened along this line, so that what is drawn there is where it is. */
  hold(ray: THREE.Ray, bodySize_m: number): void {
    this.uniforms.uHeldAt.value.copy(ray.origin);
    this.uniforms.uHeldAlong.value.copy(ray.direction);
    this.uniforms.uHeld.value.set(kHeldNear, kHeldLips, kHeldPieces, 0).multiplyScalar(bodySize_m).setW(1);
  }

  /** How much it holds: 1 as hold() said, 0 not at all. */
  get held(): number {
    return this.uniforms.uHeld.value.w;
  }
  set held(share: number) {
    this.uniforms.uHeld.value.w = share;
  }

  /** Numbers that change with it. */
  get heldLine(): number[] {
    const { uHeld, uHeldAt, uHeldAlong } = this.uniforms;
    return [uHeld.value.w, ...uHeldAt.value.toArray(), ...uHeldAlong.value.toArray()];
  }

  /** What is left, beside that line, of the opening of lips and of pieces. */
  private heldBack(x: number, y: number, z: number): readonly [number, number] {
    const { uHeld, uHeldAt, uHeldAlong } = this.uniforms;
    const held = uHeld.value;
    if (held.w === 0) return kNotHeld;
    const aside = new THREE.Vector3(x, y, z).sub(uHeldAt.value);
    const away = aside.addScaledVector(uHeldAlong.value, -aside.dot(uHeldAlong.value)).length();
    const left = (from: number) => 1 - held.w * (1 - THREE.MathUtils.smoothstep(away, held.x, from));
    return [left(held.y), left(held.z)];
  }

  /** The triangles as they are drawn, opened by this share (0 to 1). */
  shown(open: number): ShownTriangles {
    const p = this.positions();
    const facts = this.attribute("aFacts"),
      lips = this.attribute("aLips");
    const corners = (slot: number, out: Float64Array) => {
      const piece = 4 * (facts[12 * slot + 2] + 256 * facts[12 * slot + 3]);
      let size = 0;
      for (let from = 0; from < 9; from += 3) {
        const v = 9 * slot + from;
        const [ofLips, ofPieces] = this.heldBack(p[v], p[v + 1], p[v + 2]);
        for (let i = 0; i < 3; ++i) {
          size += Math.abs(p[v + i]);
          out[from + i] = p[v + i] + open * (ofLips * lips[v + i] + ofPieces * (this.pieceOffsets[piece + i] ?? 0));
        }
      }
      return size > 0;
    };
    return { slots: this.slots, corners, isCut: (slot) => facts[12 * slot] !== 0 };
  }

  private attribute(name: string): ArrayLike<number> {
    return this.mesh.geometry.getAttribute(name)?.array ?? [];
  }

  /** inside: also draw the back of the surface; detail: the fine grain. three.js keeps the shaders it has compiled. */
  setEffort(inside: boolean, detail: boolean): void {
    this.mesh.material.side = inside ? THREE.DoubleSide : THREE.FrontSide;
    this.define("INSIDE", Number(inside));
    this.define("DETAIL", Number(detail));
  }

  private define(name: string, value: number): void {
    const { material } = this.mesh;
    if (material.defines[name] === value) return;
    material.defines[name] = value;
    material.needsUpdate = true;
  }

  /**
   * Where a ray meets the skin of the body at rest, or the inside that a section shows: the distance in units of
   * `direction`, or NaN. Cut faces are skipped: a second stroke across a gap must not fall into it. O(triangles).
   * Möller and Trumbore 1997.
   */
  raycast(origin: THREE.Vector3, direction: THREE.Vector3): number {
    const p = this.positions();
    const facts = this.mesh.geometry.getAttribute("aFacts")?.array;
    const { x: ox, y: oy, z: oz } = origin;
    const { x: dx, y: dy, z: dz } = direction;
    // What a section leaves is met between these distances; without one its normal is 0.
    const { x: nx, y: ny, z: nz, w: offset } = this.uniforms.uSection.value as THREE.Vector4;
    const beyond = nx * ox + ny * oy + nz * oz - offset,
      slope = nx * dx + ny * dy + nz * dz;
    const crosses = slope === 0 ? Infinity : -beyond / slope;
    const from = beyond > 0 ? (slope < 0 ? crosses : Infinity) : 0,
      to = slope > 0 ? crosses : Infinity;
    let nearest = NaN,
      leaves = false; // the body there: the ray has come into it through the section
    for (let s = 0; s < this.slots; ++s) {
      if (facts[12 * s] !== 0) continue;
      const i = 9 * s;
      const ax = p[i],
        ay = p[i + 1],
        az = p[i + 2];
      const ux = p[i + 3] - ax,
        uy = p[i + 4] - ay,
        uz = p[i + 5] - az;
      const vx = p[i + 6] - ax,
        vy = p[i + 7] - ay,
        vz = p[i + 8] - az;
      const hx = dy * vz - dz * vy,
        hy = dz * vx - dx * vz,
        hz = dx * vy - dy * vx;
      const det = ux * hx + uy * hy + uz * hz;
      if (Math.abs(det) < 1e-18 || (det < 0 && from === 0)) continue; // it is seen edge on, or faces away
      const sign = Math.sign(det);
      const tx = ox - ax,
        ty = oy - ay,
        tz = oz - az;
      const a = sign * (tx * hx + ty * hy + tz * hz);
      if (a < 0 || a > sign * det) continue;
      const qx = ty * uz - tz * uy,
        qy = tz * ux - tx * uz,
        qz = tx * uy - ty * ux;
      const b = sign * (dx * qx + dy * qy + dz * qz);
      if (b < 0 || a + b > sign * det) continue;
      const t = (vx * qx + vy * qy + vz * qz) / det;
      if (!(t > from && t <= to) || t >= nearest) continue;
      nearest = t;
      leaves = det < 0;
    }
    return leaves ? from : nearest;
  }

  private write(
    name: string,
    size: number,
    from: ArrayLike<number>,
    slots: Uint32Array,
    ranges: [number, number][],
  ): void {
    const attribute = this.mesh.geometry.getAttribute(name) as THREE.BufferAttribute;
    const to = attribute.array;
    for (let i = 0; i < slots.length; ++i) {
      const at = size * slots[i];
      for (let k = 0; k < size; ++k) to[at + k] = from[size * i + k];
    }
    for (const [begin, end] of ranges) attribute.addUpdateRange(size * begin, size * (end - begin));
    attribute.needsUpdate = true;
  }

  private makePieceTexture(rows: number): THREE.DataTexture {
    this.pieceOffsets = new Float32Array(4 * kPieceColumns * rows);
    const texture = new THREE.DataTexture(this.pieceOffsets, kPieceColumns, rows, THREE.RGBAFormat, THREE.FloatType);
    texture.needsUpdate = true;
    return texture;
  }
}
