import type { Faces } from "./opening";
import { kNone, type Surface } from "./surface";

// Which cut faces are walls of a cut that stops in the tissue, and which were separated from another piece.

export const kUnknown = 0;
export const kWall = 1; // the other side of the gap belongs to the same piece
export const kParted = 2; // it belongs to another piece

const kOpposite = -0.9; // cosine between the normals of a gap's two sides
const kSmooth = 0.7; // cosine between the normals of neighbours in one wall
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
 * whose normal points the other way. There may be none: the gap is open in a deformed body, or another cut has
 * divided one side only. Then a face gets the kind of its neighbours in the same wall.
 */
export function sidesOf(surface: Surface, faces: Faces): Uint8Array {
  const { pieces, slots } = surface;
  const { cut, normals, areas } = faces;
  const cell = 2 * kReach * Math.sqrt(faces.cutArea / cut.length || 1);
  const grid = new FaceGrid(surface, cut, cell);
  const { centres } = grid;
  const sides = new Uint8Array(slots);
  const known: number[] = [];
  for (let i = 0; i < cut.length; ++i) {
    const s = cut[i];
    const reach = Math.min(cell, kReach * Math.sqrt(areas[s]));
    let nearest = reach * reach;
    let twin = -1;
    grid.around(i, (j) => {
      const x = centres[3 * j] - centres[3 * i],
        y = centres[3 * j + 1] - centres[3 * i + 1],
        z = centres[3 * j + 2] - centres[3 * i + 2];
      const squared = x * x + y * y + z * z;
      if (squared > nearest || cosine(normals, areas, s, cut[j]) > kOpposite) return;
      nearest = squared;
      twin = cut[j];
    });
    if (twin < 0) continue;
    sides[s] = pieces[twin] === pieces[s] ? kWall : kParted;
    known.push(s);
  }
  spread(surface, faces, sides, known);
  return sides;
}

function cosine(normals: Float32Array, areas: Float32Array, s: number, t: number): number {
  const dot =
    normals[3 * s] * normals[3 * t] + normals[3 * s + 1] * normals[3 * t + 1] + normals[3 * s + 2] * normals[3 * t + 2];
  return dot / (areas[s] * areas[t] || 1);
}

/** Spreads the known kinds across smooth edges to faces that are still unknown. */
function spread(
  { corners, head, next, flags }: Surface,
  { normals, areas }: Faces,
  sides: Uint8Array,
  known: number[],
): void {
  for (let at = 0; at < known.length; ++at) {
    const s = known[at];
    for (let k = 0; k < 3; ++k) {
      const v = corners[3 * s + k],
        w = corners[3 * s + ((k + 1) % 3)];
      for (let c = head[w]; c !== kNone; c = next[c]) {
        const t = (c / 3) | 0;
        if (corners[3 * t + ((c - 3 * t + 1) % 3)] !== v) continue; // not the neighbour across this edge
        if (!(flags[t] & 1) || sides[t] !== kUnknown || cosine(normals, areas, s, t) < kSmooth) continue;
        sides[t] = sides[s];
        known.push(t);
      }
    }
  }
}
