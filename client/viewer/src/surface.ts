import { IdMap } from "./id_map";
import { kSurfaceTriangle, kSurfaceVertex, StateHash } from "./state_hash";
import type { SurfaceVertices } from "./wire/incise/wire/surface-vertices";
import type { Triangles } from "./wire/incise/wire/triangles";

export const kNone = 0xffffffff;

/** A typed array with room for at least `count` entries, with its old contents. */
export function withRoom<T extends Float32Array | Float64Array | Uint32Array | Uint8Array | Int32Array | Int16Array>(
  array: T,
  count: number,
): T {
  if (array.length >= count) return array;
  const grown = new (array.constructor as new (n: number) => T)(Math.max(count, 2 * array.length));
  grown.set(array);
  return grown;
}

/**
 * What view Surface describes: boundary triangles and the vertices they use, each triangle in a slot that it keeps
 * until it is removed, so that buffers on the graphics card are updated in place. Vertices are indexed by their ids.
 *
 * The triangles at a vertex are a list of corners (3 slot + k): head[vertex], next[corner].
 */
export class Surface {
  positions = new Float32Array(0); // 3 a vertex
  /** Where the material of a vertex is in the body at rest, where hasRest says so; else that is its position. */
  restAt = new Float32Array(0);
  hasRest = new Uint8Array(0);
  /** Some vertex rests elsewhere than it is. */
  deformed = false;
  private present = new Uint8Array(0);
  head = new Uint32Array(0); // first corner of a vertex, or kNone
  vertexCount = 0;

  ids = new Uint32Array(0); // half-face of a slot, or kNone where it is free
  corners = new Uint32Array(0); // 3 vertices a slot
  flags = new Uint8Array(0);
  pieces = new Uint32Array(0);
  regions = new Int32Array(0);
  origins = new Uint32Array(0); // triangle of the surface that the body was filled from, or kNone
  next = new Uint32Array(0);
  slots = 0; // used so far
  private free: number[] = [];
  private slotOf = new IdMap();
  private hash = new StateHash();
  private trianglesOf = new Map<number, number>(); // of each piece
  private words = new Uint32Array(5);
  private floatBits = new Uint32Array(0); // positions, as bits

  /** What changed since clearTouched(): slots, and vertices whose triangles may look different. */
  readonly touchedSlots = new Set<number>();
  readonly touchedVertices = new Set<number>();

  get triangleCount(): number {
    return this.slotOf.size;
  }
  /** Every piece has a boundary, so every piece is counted. */
  get pieceCount(): number {
    return this.trianglesOf.size;
  }
  get surfaceHash(): bigint {
    return this.hash.value;
  }

  clear(): void {
    this.present.fill(0);
    this.hasRest.fill(0);
    this.head.fill(kNone);
    this.ids.fill(kNone);
    this.vertexCount = this.slots = 0;
    this.deformed = false;
    this.free.length = 0;
    this.slotOf.clear();
    this.trianglesOf.clear();
    this.hash.clear();
    this.clearTouched();
  }

  clearTouched(): void {
    this.touchedSlots.clear();
    this.touchedVertices.clear();
  }

  /** Where a half-face is; -1: it is not on the surface. */
  slotFor(halfFace: number): number {
    return this.slotOf.get(halfFace);
  }

  /** New and moved vertices. False if the arrays do not fit each other. */
  setVertices(vertices: SurfaceVertices | null): boolean {
    const ids = vertices?.idsArray();
    const positions = vertices?.positionsArray();
    if (!ids || ids.length === 0) return !positions || positions.length === 0;
    if (!positions || positions.length !== 3 * ids.length) return false;
    this.roomForVertices(ids[ids.length - 1] + 1);
    for (let i = 0; i < ids.length; ++i) {
      const v = ids[i];
      if (this.present[v]) this.toggleVertex(v);
      else ++this.vertexCount;
      this.present[v] = 1;
      this.positions.set(positions.subarray(3 * i, 3 * i + 3), 3 * v);
      this.toggleVertex(v);
      this.touchedVertices.add(v);
    }
    return true;
  }

  /** Rest positions of vertices that are present. */
  setRest(rest: SurfaceVertices | null): boolean {
    const ids = rest?.idsArray();
    const positions = rest?.positionsArray();
    if (!ids || ids.length === 0) return true;
    if (positions?.length !== 3 * ids.length) return false;
    for (let i = 0; i < ids.length; ++i) {
      const v = ids[i];
      if (v >= this.present.length || !this.present[v]) return false;
      this.hasRest[v] = 1;
      this.deformed = true;
      this.restAt.set(positions.subarray(3 * i, 3 * i + 3), 3 * v);
      this.touchedVertices.add(v);
    }
    return true;
  }

  /** Where vertex v is in the body at rest: three numbers from 3 v on. */
  restOf(v: number): Float32Array {
    return this.hasRest[v] ? this.restAt : this.positions;
  }

  /** Writes where the corners of a slot are in the body at rest: 9 numbers from out[at] on. */
  restCorners(slot: number, out: Float32Array, at = 0): void {
    for (let k = 0; k < 3; ++k) {
      const v = this.corners[3 * slot + k];
      const from = this.restOf(v);
      for (let i = 0; i < 3; ++i) out[at + 3 * k + i] = from[3 * v + i];
    }
  }

  removeVertices(ids: Uint32Array | null): void {
    for (const v of ids ?? []) {
      if (v >= this.present.length || !this.present[v]) continue;
      this.toggleVertex(v);
      this.present[v] = this.hasRest[v] = 0;
      --this.vertexCount;
    }
  }

  /** New and changed triangles; their vertices must be present. */
  setTriangles(triangles: Triangles | null): boolean {
    const ids = triangles?.idsArray();
    if (!triangles || !ids || ids.length === 0) return true;
    const vertices = triangles.verticesArray();
    const flags = triangles.flagsArray();
    const pieces = triangles.piecesArray();
    const regions = triangles.regionsArray();
    const origins = triangles.originsArray(); // null: none has one
    if (regions && regions.length !== ids.length) return false;
    if (origins && origins.length !== ids.length && origins.length > 0) return false;
    if (vertices?.length !== 3 * ids.length || flags?.length !== ids.length || pieces?.length !== ids.length)
      return false;
    for (const v of vertices) {
      if (v >= this.present.length || !this.present[v]) return false;
    }
    for (let i = 0; i < ids.length; ++i) {
      let slot = this.slotOf.get(ids[i]);
      if (slot >= 0) this.unhang(slot);
      else slot = this.freshSlot(ids[i]);
      this.corners.set(vertices.subarray(3 * i, 3 * i + 3), 3 * slot);
      this.flags[slot] = flags[i];
      this.pieces[slot] = pieces[i];
      this.regions[slot] = regions?.[i] ?? 0;
      this.origins[slot] = origins?.[i] ?? kNone;
      this.hang(slot);
    }
    return true;
  }

  removeTriangles(ids: Uint32Array | null): void {
    for (const id of ids ?? []) {
      const slot = this.slotOf.get(id);
      if (slot < 0) continue;
      this.unhang(slot);
      this.slotOf.remove(id);
      this.ids[slot] = kNone;
      this.free.push(slot);
      this.touchedSlots.add(slot);
    }
  }

  private roomForVertices(count: number): void {
    const before = this.present.length;
    if (count <= before) return;
    this.positions = withRoom(this.positions, 3 * count);
    this.floatBits = new Uint32Array(this.positions.buffer);
    this.present = withRoom(this.present, this.positions.length / 3);
    this.restAt = withRoom(this.restAt, this.positions.length);
    this.hasRest = withRoom(this.hasRest, this.present.length);
    this.head = withRoom(this.head, this.present.length);
    this.head.fill(kNone, before);
  }

  private freshSlot(id: number): number {
    const slot = this.free.pop() ?? this.slots++;
    this.ids = withRoom(this.ids, slot + 1);
    this.corners = withRoom(this.corners, 3 * slot + 3);
    this.flags = withRoom(this.flags, slot + 1);
    this.pieces = withRoom(this.pieces, slot + 1);
    this.regions = withRoom(this.regions, slot + 1);
    this.origins = withRoom(this.origins, slot + 1);
    this.next = withRoom(this.next, 3 * slot + 3);
    this.ids[slot] = id;
    this.slotOf.add(id, slot);
    return slot;
  }

  private hang(slot: number): void {
    this.toggleTriangle(slot);
    this.trianglesOf.set(this.pieces[slot], (this.trianglesOf.get(this.pieces[slot]) ?? 0) + 1);
    for (let c = 3 * slot; c < 3 * slot + 3; ++c) {
      const v = this.corners[c];
      this.next[c] = this.head[v];
      this.head[v] = c;
      this.touchedVertices.add(v);
    }
    this.touchedSlots.add(slot);
  }

  private unhang(slot: number): void {
    this.toggleTriangle(slot);
    const left = this.trianglesOf.get(this.pieces[slot])! - 1;
    if (left > 0) this.trianglesOf.set(this.pieces[slot], left);
    else this.trianglesOf.delete(this.pieces[slot]);
    for (let c = 3 * slot; c < 3 * slot + 3; ++c) {
      const v = this.corners[c];
      if (this.head[v] === c) {
        this.head[v] = this.next[c];
      } else {
        let before = this.head[v];
        while (this.next[before] !== c) before = this.next[before];
        this.next[before] = this.next[c];
      }
      this.touchedVertices.add(v);
    }
  }

  private toggleVertex(v: number): void {
    this.words[0] = v;
    for (let k = 0; k < 3; ++k) this.words[1 + k] = this.floatBits[3 * v + k];
    this.hash.toggle(kSurfaceVertex, this.words, 4);
  }

  private toggleTriangle(slot: number): void {
    this.words[0] = this.ids[slot];
    for (let k = 0; k < 3; ++k) this.words[1 + k] = this.corners[3 * slot + k];
    this.words[4] = this.flags[slot];
    this.hash.toggle(kSurfaceTriangle, this.words, 5);
  }
}
