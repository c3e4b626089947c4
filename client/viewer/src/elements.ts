import { withRoom } from "./surface";
import { faceNormal } from "./triangle";
import type { Delta } from "./wire/incise/wire/delta";
import type { SnapshotChunk } from "./wire/incise/wire/snapshot-chunk";
import type { Tets } from "./wire/incise/wire/tets";

/** The smallest dihedral angle that is shown as good, degrees; that of a regular tetrahedron is 70.5. */
export const kGoodAngle_deg = 45;

/**
 * The tetrahedra of view Volume, for their shape: the four vertices of each, their positions and the
 * smallest of the six dihedral angles. Tetrahedra and vertices are indexed by their ids. Several times as large as the
 * surface, so it is held only while the page colours by it.
 */
export class Elements {
  private positions = new Float64Array(0); // 3 a vertex
  private moved = new Uint8Array(0); // a vertex, in this delta
  private vertices = new Uint32Array(0); // 4 a tetrahedron
  private present = new Uint8Array(0);
  private tets = 0; // all ids are below it
  /** 0 to 255: the smallest dihedral angle of a tetrahedron, up to kGoodAngle_deg. */
  quality = new Uint8Array(0);

  clear(): void {
    this.present.fill(0);
    this.tets = 0;
  }

  addChunk(chunk: SnapshotChunk): void {
    this.place(chunk.firstVertex(), chunk.positionsArray());
    this.setTets(chunk.tets());
  }

  apply(delta: Delta): void {
    const ids = delta.movedIdsArray() ?? new Uint32Array(0);
    const positions = delta.movedPositionsArray() ?? new Float64Array(0);
    for (let i = 0; i < ids.length; ++i) {
      this.positions.set(positions.subarray(3 * i, 3 * i + 3), 3 * ids[i]);
      this.moved[ids[i]] = 1;
    }
    this.place(delta.firstAdded(), delta.addedPositionsArray());
    this.setTets(delta.tets());
    for (const t of delta.removedTetsArray() ?? []) this.present[t] = 0;
    if (ids.length === 0) return;
    const { vertices, moved } = this;
    for (let t = 0, v = 0; t < this.tets; ++t, v += 4) {
      if (
        this.present[t] &&
        (moved[vertices[v]] || moved[vertices[v + 1]] || moved[vertices[v + 2]] || moved[vertices[v + 3]])
      )
        this.measure(t);
    }
    for (const v of ids) moved[v] = 0;
  }

  private place(first: number, positions: Float64Array | null): void {
    if (!positions || positions.length === 0) return;
    this.positions = withRoom(this.positions, 3 * first + positions.length);
    this.moved = withRoom(this.moved, this.positions.length / 3);
    this.positions.set(positions, 3 * first);
  }

  private setTets(tets: Tets | null): void {
    const ids = tets?.idsArray();
    const vertices = tets?.verticesArray();
    if (!ids || !vertices || ids.length === 0) return;
    const end = ids[ids.length - 1] + 1; // ids ascend
    this.vertices = withRoom(this.vertices, 4 * end);
    this.present = withRoom(this.present, end);
    this.quality = withRoom(this.quality, end);
    this.tets = Math.max(this.tets, end);
    for (let i = 0; i < ids.length; ++i) {
      this.vertices.set(vertices.subarray(4 * i, 4 * i + 4), 4 * ids[i]);
      this.present[ids[i]] = 1;
      this.measure(ids[i]);
    }
  }

  /** The faces' normals point outwards, so the angle between two faces is pi minus that between their normals. */
  private measure(t: number): void {
    const p = this.positions,
      v = 4 * t;
    const a = 3 * this.vertices[v],
      b = 3 * this.vertices[v + 1],
      c = 3 * this.vertices[v + 2],
      d = 3 * this.vertices[v + 3];
    const n = kNormals;
    unitNormal(p, b, d, c, 0);
    unitNormal(p, a, c, d, 3);
    unitNormal(p, a, d, b, 6);
    unitNormal(p, a, b, c, 9);
    let most = -1; // cosine of the smallest angle
    for (let i = 0; i < 9; i += 3) {
      for (let j = i + 3; j < 12; j += 3)
        most = Math.max(most, -(n[i] * n[j] + n[i + 1] * n[j + 1] + n[i + 2] * n[j + 2]));
    }
    const angle_deg = (Math.acos(Math.min(1, most)) * 180) / Math.PI;
    this.quality[t] = Math.round(255 * Math.min(1, angle_deg / kGoodAngle_deg));
  }
}

const kNormals = new Float64Array(12); // of the four faces of the tetrahedron being measured

function unitNormal(p: Float64Array, a: number, b: number, c: number, at: number): void {
  const scale = 1 / (faceNormal(p, a, b, c, kNormals, at) || 1);
  for (let k = 0; k < 3; ++k) kNormals[at + k] *= scale;
}
