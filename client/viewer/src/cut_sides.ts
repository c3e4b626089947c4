import type { Faces } from "./opening";
import { kNone, type Surface } from "./surface";

// Which cut faces are walls of a cut that stops in the tissue, and which were separated from another piece.

const kCut = 1;
export const kUnknown = 0;
export const kWall = 1; // the other side of the gap belongs to the same piece
export const kParted = 2; // it belongs to another piece

const kOpposite = -0.9; // cosine between the normals of a gap's two sides
const kSmooth = 0.7; // cosine between the normals of neighbours in one wall
const kFolded = -0.5; // below it the edge is a front, also where a simulation lets the walls pass through each other
const kConvex = 0.1; // sine of the angle below the plane of its neighbour at which a face is another sheet's
const kCancels = 0.7; // of its area: a sheet whose normals sum to less has both sides of a gap
const kLeastWall = 12; // faces: a smaller sheet in a deformed body is a flap, which would stick out as a spike
const kReach = 0.35; // times the root of a face's area: how far away its other side may be

/** Cut faces by place: a grid over their centres, in a hash table of chains. */
class FaceGrid {
  readonly centres: Float32Array; // 3 for each of the cut faces
  private readonly first = new Map<number, number>(); // by cell: an index into the cut faces
  private readonly following: Int32Array; // -1: the last of its chain

  constructor(
    { positions: p, corners }: Surface,
    cut: number[],
    private readonly cell: number,
  ) {
    this.centres = new Float32Array(3 * cut.length);
    this.following = new Int32Array(cut.length);
    for (let i = 0; i < cut.length; ++i) {
      for (let k = 0; k < 3; ++k) {
        const sum =
          p[3 * corners[3 * cut[i]] + k] + p[3 * corners[3 * cut[i] + 1] + k] + p[3 * corners[3 * cut[i] + 2] + k];
        this.centres[3 * i + k] = sum / 3;
      }
      const key = this.key(this.index(3 * i), this.index(3 * i + 1), this.index(3 * i + 2));
      this.following[i] = this.first.get(key) ?? -1;
      this.first.set(key, i);
    }
  }

  /** Visits each face in the cells around face i. Cells that share a hash are visited as well. */
  around(i: number, visit: (other: number) => void): void {
    const x = this.index(3 * i),
      y = this.index(3 * i + 1),
      z = this.index(3 * i + 2);
    for (let n = 0; n < 27; ++n) {
      let other = this.first.get(this.key(x + (n % 3) - 1, y + (((n / 3) | 0) % 3) - 1, z + ((n / 9) | 0) - 1)) ?? -1;
      for (; other >= 0; other = this.following[other]) visit(other);
    }
  }

  private index(at: number): number {
    return Math.floor(this.centres[at] / this.cell);
  }
  private key(x: number, y: number, z: number): number {
    return Math.imul(x, 73856093) ^ Math.imul(y, 19349663) ^ Math.imul(z, 83492791);
  }
}

/**
 * For each slot kUnknown, kWall or kParted. The other side of a cut face is the nearest cut face at the same place
 * whose normal points the other way. There may be none: another cut has divided one side only, and then a face gets the
 * kind of its neighbours; or the gap is open in a deformed body, and then the shape of the whole sheet decides.
 */
export function sidesOf(surface: Surface, faces: Faces): Uint8Array {
  const sides = new Uint8Array(surface.slots);
  matchTwins(surface, faces, sides);
  decideSheets(surface, faces, sides);
  const known = faces.cut.filter((s) => sides[s] !== kUnknown);
  for (let at = 0; at < known.length; ++at) {
    forNeighbours(surface, known[at], (t, edge) => {
      if (sides[t] !== kUnknown || !continues(surface, faces, known[at], t, edge)) return;
      sides[t] = sides[known[at]];
      known.push(t);
    });
  }
  return sides;
}

function matchTwins(surface: Surface, faces: Faces, sides: Uint8Array): void {
  const { cut, areas } = faces;
  const cell = 2 * kReach * Math.sqrt(faces.cutArea / cut.length || 1);
  const grid = new FaceGrid(surface, cut, cell);
  const { centres } = grid;
  for (let i = 0; i < cut.length; ++i) {
    const s = cut[i];
    const reach = Math.min(cell, kReach * Math.sqrt(areas[s]));
    let nearest = reach * reach;
    let twin = -1;
    grid.around(i, (j) => {
      const x = centres[3 * j] - centres[3 * i];
      const y = centres[3 * j + 1] - centres[3 * i + 1];
      const z = centres[3 * j + 2] - centres[3 * i + 2];
      const squared = x * x + y * y + z * z;
      if (squared > nearest || cosine(faces, s, cut[j]) > kOpposite) return;
      nearest = squared;
      twin = cut[j];
    });
    if (twin >= 0) sides[s] = surface.pieces[twin] === surface.pieces[s] ? kWall : kParted;
  }
}

/**
 * Where few faces of a sheet have a twin, the gap is open. The two walls of a cut that stops in the tissue hang together
 * around its front, so that their normals cancel; those of a parted face do not.
 */
function decideSheets(surface: Surface, faces: Faces, sides: Uint8Array): void {
  const { cut, normals, areas } = faces;
  const parent = new Map<number, number>(cut.map((s) => [s, s]));
  const rootOf = (s: number): number => {
    while (parent.get(s) !== s) {
      parent.set(s, parent.get(parent.get(s)!)!);
      s = parent.get(s)!;
    }
    return s;
  };
  for (const s of cut) {
    forNeighbours(surface, s, (t, edge) => {
      if (continues(surface, faces, s, t, edge)) parent.set(rootOf(s), rootOf(t));
    });
  }
  const sheets = new Map<number, Sheet>();
  for (const s of cut) {
    const root = rootOf(s);
    if (!sheets.has(root)) sheets.set(root, { slots: [], normal: [0, 0, 0], area: 0, known: 0 });
    const sheet = sheets.get(root)!;
    sheet.slots.push(s);
    for (let k = 0; k < 3; ++k) sheet.normal[k] += normals[3 * s + k];
    sheet.area += areas[s];
    if (sides[s] !== kUnknown) sheet.known += areas[s];
  }
  for (const { slots, normal, area, known } of sheets.values()) {
    if (known >= 0.5 * area) continue;
    const kind = slots.length >= kLeastWall && Math.hypot(...normal) < kCancels * area ? kWall : kParted;
    for (const s of slots) sides[s] = kind;
  }
}

interface Sheet {
  slots: number[];
  normal: number[];
  area: number;
  known: number; // area of faces with a twin
}

/** The area of one side of the cut at this slot: the cut faces that go on smoothly from there. */
export function sideArea(surface: Surface, faces: Faces, slot: number): number {
  const side = new Set([slot]);
  let area = 0;
  for (const s of side) {
    area += faces.areas[s];
    forNeighbours(surface, s, (t) => {
      if (cosine(faces, s, t) > kSmooth) side.add(t);
    });
  }
  return area;
}

function cosine({ normals: n, areas }: Faces, s: number, t: number): number {
  const dot = n[3 * s] * n[3 * t] + n[3 * s + 1] * n[3 * t + 1] + n[3 * s + 2] * n[3 * t + 2];
  return dot / (areas[s] * areas[t] || 1);
}

/** Visits the cut faces across the edges of s; `edge` is the first corner of the edge in s. */
function forNeighbours(
  { corners, head, next, flags }: Surface,
  s: number,
  visit: (t: number, edge: number) => void,
): void {
  for (let k = 0; k < 3; ++k) {
    const v = corners[3 * s + k];
    const w = corners[3 * s + ((k + 1) % 3)];
    for (let c = head[w]; c !== kNone; c = next[c]) {
      const t = (c / 3) | 0;
      if (flags[t] & kCut && corners[3 * t + ((c - 3 * t + 1) % 3)] === v) visit(t, 3 * s + k);
    }
  }
}

/** Whether t belongs to the same sheet as s: smoothly, or around the front of a cut, where tissue is on the outside. */
function continues({ positions: p, corners }: Surface, faces: Faces, s: number, t: number, edge: number): boolean {
  const angle = cosine(faces, s, t);
  if (angle > kSmooth || angle < kFolded) return true;
  const v = corners[edge];
  const w = corners[3 * s + ((edge - 3 * s + 1) % 3)];
  const far = [0, 1, 2].map((k) => corners[3 * t + k]).find((u) => u !== v && u !== w)!;
  let height = 0; // of t's far corner above the plane of s, times the area of s
  let squared = 0; // length of the edge
  for (let k = 0; k < 3; ++k) {
    height += (p[3 * far + k] - p[3 * v + k]) * faces.normals[3 * s + k];
    squared += (p[3 * w + k] - p[3 * v + k]) ** 2;
  }
  const reach = (2 * faces.areas[t]) / Math.sqrt(squared || 1);
  return height > -kConvex * reach * faces.areas[s];
}
