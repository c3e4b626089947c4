import type { Elements } from "./elements";
import type { SkinDepth } from "./skin_depth";
import { kNone, type Surface, withRoom } from "./surface";
import type { SurfaceAsset } from "./surface_asset";
import { faceNormal } from "./triangle";

/** What the graphics card gets for each corner of a triangle; the three corners of a slot are adjacent. */
export interface Corners {
  ids: Uint32Array; // 1 a slot: its half-face, or kNone
  positions: Float32Array; // 3 a corner, metres
  normals: Int16Array; // 4 a corner, normalised; the fourth is the grain of the tissue, 0 to 1
  facts: Uint8Array; // 4 a corner: 0, or on a cut face its depth below the skin (1: at it, 255: kRim or more), quality (0 to 255), row of its piece (low byte, high byte)
  rest: Float32Array; // 3 a corner: where its material is in the body at rest; empty: at its position
  texture: Float32Array; // 3 a corner: u, v and layer of the texture, which is -1 where there is none; empty: the body has no texture
  regions: Float32Array; // 1 a corner: the index of its region's look; empty: all look the same
}

export function allocateCorners(slots: number, textured = false, deformed = false, regions = false): Corners {
  return {
    ids: new Uint32Array(slots),
    positions: new Float32Array(9 * slots),
    normals: new Int16Array(12 * slots),
    facts: new Uint8Array(12 * slots),
    rest: new Float32Array(deformed ? 9 * slots : 0),
    texture: new Float32Array(textured ? 9 * slots : 0),
    regions: new Float32Array(regions ? 3 * slots : 0),
  };
}

// Faces that meet at less than this are shaded as one smooth surface.
const kCreaseCosine = Math.cos((42 * Math.PI) / 180);
const kCut = 1;
/** How deep below the skin tissue looks other than farther in, as a part of the body's size. */
export const kRim = 0.035;

function hash(x: number, y: number, z: number): number {
  let h = Math.imul(x, 0x9e3779b1) ^ Math.imul(y, 0x85ebca77) ^ Math.imul(z, 0xc2b2ae3d);
  h = Math.imul(h ^ (h >>> 15), 0x2c1b3c6d);
  return ((h ^ (h >>> 13)) >>> 0) / 2 ** 32;
}

/**
 * A smooth random field, 0 to 1: value noise on a grid of `cells` a metre. It depends on the place alone, so it does
 * not move when triangles change.
 */
function grain(p: Float32Array, at: number, cells: number): number {
  const x = p[at] * cells,
    y = p[at + 1] * cells,
    z = p[at + 2] * cells;
  const i = Math.floor(x),
    j = Math.floor(y),
    k = Math.floor(z);
  const ease = (t: number) => t * t * (3 - 2 * t);
  const u = ease(x - i),
    v = ease(y - j),
    w = ease(z - k);
  let sum = 0;
  for (let corner = 0; corner < 8; ++corner) {
    const a = corner & 1,
      b = (corner >> 1) & 1,
      c = corner >> 2;
    sum += hash(i + a, j + b, k + c) * (a ? u : 1 - u) * (b ? v : 1 - v) * (c ? w : 1 - w);
  }
  return sum;
}

/** Makes corners from a surface: normals smooth over skin and over cut faces, with an edge between the two. */
export class CornerBuilder {
  private faceNormals = new Float32Array(0); // 3 a slot, twice the area long
  private quality = new Uint8Array(0); // a slot
  private rows = new Map<number, number>();

  constructor(private readonly surface: Surface) {}

  /** A small number for each piece, in the order of first use; piece 0 has row 0. */
  rowOf(piece: number): number {
    let row = this.rows.get(piece);
    if (row === undefined) this.rows.set(piece, (row = Math.min(this.rows.size, 65535)));
    return row;
  }
  get rowCount(): number {
    return this.rows.size;
  }

  /** The tetrahedra behind the triangles, whose quality is shown. Null: the triangles' own quality is shown. */
  elements: Elements | null = null;

  /** The surface whose texture is shown. Null: none. */
  asset: SurfaceAsset | null = null;
  private readonly rest = new Float32Array(9);

  /** By region: its place in the list of looks. */
  regionIndex: ReadonlyMap<number, number> = new Map();

  /** Where the skin is. Null: all tissue looks as if it were deep inside. */
  skin: SkinDepth | null = null;
  private depths = new Float32Array(0); // 4 a vertex: where it rested when its depth was computed, and the depth

  /** Marks the triangles whose quality has changed. */
  touchByQuality(): void {
    const { surface } = this;
    for (let slot = 0; slot < surface.slots; ++slot) {
      if (surface.ids[slot] !== kNone && this.quality[slot] !== this.qualityOf(slot)) surface.touchedSlots.add(slot);
    }
  }

  /** Cells of the tissue's grain in a metre. */
  grainCells = 200;

  restart(): void {
    this.rows.clear();
    this.rowOf(0);
    this.depths.fill(NaN);
  }

  /** The slots to draw again, ascending: those that changed and those around their vertices. */
  touched(): Uint32Array {
    const { surface } = this;
    const slots = new Set(surface.touchedSlots);
    for (const v of surface.touchedVertices) {
      for (let c = surface.head[v]; c !== kNone; c = surface.next[c]) slots.add((c / 3) | 0);
    }
    for (const slot of slots) this.measure(slot);
    // A face that turned changes the smooth normals of its neighbours.
    for (const slot of [...slots]) {
      if (surface.ids[slot] === kNone) continue;
      for (let k = 0; k < 3; ++k) {
        for (let c = surface.head[surface.corners[3 * slot + k]]; c !== kNone; c = surface.next[c])
          slots.add((c / 3) | 0);
      }
    }
    return Uint32Array.from(slots).sort();
  }

  measureAll(): void {
    for (let slot = 0; slot < this.surface.slots; ++slot) this.measure(slot);
  }

  /** Normal and quality of one triangle. */
  private measure(slot: number): void {
    this.faceNormals = withRoom(this.faceNormals, 3 * slot + 3);
    this.quality = withRoom(this.quality, slot + 1);
    const { positions: p, corners } = this.surface;
    if (this.surface.ids[slot] === kNone) return;
    const at = 3 * slot;
    faceNormal(p, 3 * corners[at], 3 * corners[at + 1], 3 * corners[at + 2], this.faceNormals, at);
    this.quality[slot] = this.qualityOf(slot);
  }

  private qualityOf(slot: number): number {
    const { positions: p, corners, ids } = this.surface;
    if (this.elements) return this.elements.quality[ids[slot] >>> 2];
    let squares = 0;
    for (let k = 0; k < 3; ++k) {
      const a = 3 * corners[3 * slot + k],
        b = 3 * corners[3 * slot + ((k + 1) % 3)];
      squares += (p[b] - p[a]) ** 2 + (p[b + 1] - p[a + 1]) ** 2 + (p[b + 2] - p[a + 2]) ** 2;
    }
    // 4 sqrt(3) area / sum of squared sides: 1 for an equilateral triangle, 0 for a flat one (Bank 1994).
    const shape =
      squares > 0 ? (2 * Math.sqrt(3) * Math.hypot(...this.faceNormals.subarray(3 * slot, 3 * slot + 3))) / squares : 0;
    return Math.round(255 * Math.min(1, shape));
  }

  /** Writes the corners of `slot` at place `at` of `out`. A free slot gets a triangle of size 0. */
  write(slot: number, out: Corners, at: number): void {
    const { surface, faceNormals } = this;
    out.ids[at] = surface.ids[slot];
    if (surface.ids[slot] === kNone) {
      out.positions.fill(0, 9 * at, 9 * at + 9);
      return;
    }
    const row = this.rowOf(surface.pieces[slot]);
    for (let k = 0; k < 3; ++k) {
      const v = surface.corners[3 * slot + k];
      for (let i = 0; i < 3; ++i) out.positions[9 * at + 3 * k + i] = surface.positions[3 * v + i];
      this.writeNormal(slot, v, faceNormals, out.normals, 12 * at + 4 * k);
      out.normals[12 * at + 4 * k + 3] = 32767 * grain(surface.restOf(v), 3 * v, this.grainCells);
      const fact = 12 * at + 4 * k;
      out.facts[fact] = surface.flags[slot] & kCut ? this.depthOf(v) : 0;
      out.facts[fact + 1] = this.quality[slot];
      out.facts[fact + 2] = row & 255;
      out.facts[fact + 3] = row >> 8;
    }
    if (out.regions.length > 0) out.regions.fill(this.regionIndex.get(surface.regions[slot]) ?? 0, 3 * at, 3 * at + 3);
    if (out.rest.length > 0) surface.restCorners(slot, out.rest, 9 * at);
    if (out.texture.length > 0) this.writeTexture(slot, out.texture, 9 * at);
  }

  private depthOf(v: number): number {
    if (!this.skin) return 255;
    if (this.depths.length < 4 * v + 4) {
      const before = this.depths.length;
      this.depths = withRoom(this.depths, 4 * v + 4);
      this.depths.fill(NaN, before);
    }
    const { depths } = this;
    const at = this.surface.restOf(v);
    if (depths[4 * v] !== at[3 * v] || depths[4 * v + 1] !== at[3 * v + 1] || depths[4 * v + 2] !== at[3 * v + 2]) {
      for (let i = 0; i < 3; ++i) depths[4 * v + i] = at[3 * v + i];
      depths[4 * v + 3] = this.skin.at(at[3 * v], at[3 * v + 1], at[3 * v + 2]) / this.skin.reach;
    }
    return 1 + Math.round(254 * depths[4 * v + 3]);
  }

  private writeTexture(slot: number, out: Float32Array, at: number): void {
    const { asset, surface, rest } = this;
    const origin = surface.origins[slot];
    surface.restCorners(slot, rest);
    const has = asset !== null && origin !== kNone && asset.cornerUvs(origin, rest, out, at, 3);
    const layer = has ? (asset.materialOf[origin] ?? 0) : -1;
    for (let k = 0; k < 3; ++k) out[at + 3 * k + 2] = layer;
  }

  private writeNormal(slot: number, v: number, n: Float32Array, out: Int16Array, at: number): void {
    const { surface } = this;
    const x = n[3 * slot],
      y = n[3 * slot + 1],
      z = n[3 * slot + 2];
    const length = Math.hypot(x, y, z);
    const cut = surface.flags[slot] & kCut;
    let sx = 0,
      sy = 0,
      sz = 0;
    for (let c = surface.head[v]; c !== kNone; c = surface.next[c]) {
      const other = (c / 3) | 0;
      if ((surface.flags[other] & kCut) !== cut) continue;
      const ox = n[3 * other],
        oy = n[3 * other + 1],
        oz = n[3 * other + 2];
      if (other !== slot && x * ox + y * oy + z * oz < kCreaseCosine * length * Math.hypot(ox, oy, oz)) continue;
      sx += ox;
      sy += oy;
      sz += oz;
    }
    const scale = 32767 / (Math.hypot(sx, sy, sz) || 1);
    out[at] = sx * scale;
    out[at + 1] = sy * scale;
    out[at + 2] = sz * scale;
  }
}
