import { kNone, type Surface, withRoom } from "./surface";

// How the body is shown opened: a displacement for the lips of cuts that stop inside the tissue, and one for each piece
// that has come free. Only what is drawn moves; positions and hashes stay.

const kCut = 1;
const kRounds = 70;
const kSpread = 0.03; // the share that a vertex away from the cut loses: the reach is about 1 / sqrt(kSpread) edges
const kLift = 0.085; // of the body's size: how far a lip is pulled
const kPull = 0.12; // of a cut face's vertex away from the gap

/** Union-find over slots: patches of cut faces that hang together. */
class Patches {
  private parent: Uint32Array;
  constructor(count: number) {
    this.parent = Uint32Array.from({ length: count }, (_, i) => i);
  }
  find(i: number): number {
    const { parent } = this;
    while (parent[i] !== i) i = parent[i] = parent[parent[i]];
    return i;
  }
  join(a: number, b: number): void {
    this.parent[this.find(a)] = this.find(b);
  }
}

export interface Opening {
  /** 3 a vertex id, metres: where it is shown, fully opened, from where it is. */
  lips: Float32Array;
  /** 4 a row of a piece: x, y, z in metres, and 0. */
  pieces: Float32Array;
  /** One side, m^2. */
  cutArea_m2: number;
}

/**
 * Lips: over the surface's graph, d solves a screened Laplace equation in which each vertex on one side of a partial cut
 * is pulled back along the cut face's normal, and the crack front, where both sides share their vertices and so the
 * normals cancel, is held. A patch of cut faces is partial where the normals of its faces cancel (both sides of the cut
 * hang together around the front); the faces of a piece that came free do not, and the piece moves as a whole.
 *
 * Time: kRounds times the vertices near cuts. Thread: the worker's.
 */
export function computeOpening(surface: Surface, rowOf: (piece: number) => number, rows: number, size: number, out: Opening): void {
  const { positions: p, corners, slots, ids, flags, head, next } = surface;
  const vertices = head.length;
  out.lips = withRoom(out.lips, 3 * vertices).fill(0);

  const normals = new Float32Array(3 * slots);
  const areas = new Float32Array(slots);
  const patches = new Patches(slots);
  let cutFaces = 0;
  out.cutArea_m2 = 0;
  for (let s = 0; s < slots; ++s) {
    if (ids[s] === kNone) continue;
    const a = 3 * corners[3 * s], b = 3 * corners[3 * s + 1], c = 3 * corners[3 * s + 2];
    const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
    const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
    normals[3 * s] = (uy * vz - uz * vy) / 2;
    normals[3 * s + 1] = (uz * vx - ux * vz) / 2;
    normals[3 * s + 2] = (ux * vy - uy * vx) / 2;
    areas[s] = Math.hypot(normals[3 * s], normals[3 * s + 1], normals[3 * s + 2]);
    if (!(flags[s] & kCut)) continue;
    ++cutFaces;
    out.cutArea_m2 += areas[s] / 2;
    for (let k = 0; k < 3; ++k) {
      for (let other = head[corners[3 * s + k]]; other !== kNone; other = next[other]) {
        const t = (other / 3) | 0;
        if (flags[t] & kCut) patches.join(s, t);
      }
    }
  }
  movePieces(surface, normals, areas, rowOf, rows, size, out);
  if (cutFaces === 0) return;

  const sums = new Float64Array(4 * slots); // normal and area of the patch, at its root
  for (let s = 0; s < slots; ++s) {
    if (ids[s] === kNone || !(flags[s] & kCut)) continue;
    const root = 4 * patches.find(s);
    for (let k = 0; k < 3; ++k) sums[root + k] += normals[3 * s + k];
    sums[root + 3] += areas[s];
  }
  const target = new Float32Array(3 * vertices);
  const pull = new Float32Array(vertices); // 0: skin; kPull: a lip; large: held
  const near: number[] = [];
  const known = new Uint8Array(vertices);
  for (let v = 0; v < vertices; ++v) {
    let x = 0, y = 0, z = 0, area = 0, partial = 0;
    for (let c = head[v]; c !== kNone; c = next[c]) {
      const s = (c / 3) | 0;
      if (!(flags[s] & kCut)) continue;
      const root = 4 * patches.find(s);
      partial = Math.max(partial, 1 - Math.hypot(sums[root], sums[root + 1], sums[root + 2]) / (sums[root + 3] || 1));
      x += normals[3 * s];
      y += normals[3 * s + 1];
      z += normals[3 * s + 2];
      area += areas[s];
    }
    if (area === 0 || partial < 0.3) continue;
    const length = Math.hypot(x, y, z);
    known[v] = 1;
    near.push(v);
    if (length < 0.5 * area) {
      pull[v] = 1e3;
    } else {
      pull[v] = kPull;
      const lift = (-kLift * size) / length;
      target.set([lift * x, lift * y, lift * z], 3 * v);
    }
  }
  // The skin within reach of the lips.
  for (let from = 0, ring = 0; ring < 14; ++ring) {
    const end = near.length;
    for (; from < end; ++from) {
      for (let c = head[near[from]]; c !== kNone; c = next[c]) {
        const s = 3 * ((c / 3) | 0);
        for (let k = 0; k < 3; ++k) {
          const w = corners[s + k];
          if (!known[w]) {
            known[w] = 1;
            near.push(w);
          }
        }
      }
    }
  }
  relax(surface, near, target, pull, out.lips);
}

function relax(surface: Surface, near: number[], target: Float32Array, pull: Float32Array, d: Float32Array): void {
  const { corners, head, next } = surface;
  for (let round = 0; round < kRounds; ++round) {
    for (let i = 0; i < near.length; ++i) {
      const v = near[round & 1 ? near.length - 1 - i : i];
      let x = 0, y = 0, z = 0, count = 0;
      for (let c = head[v]; c !== kNone; c = next[c]) {
        const s = 3 * ((c / 3) | 0);
        const w = 3 * corners[s + ((c - s + 1) % 3)];
        x += d[w];
        y += d[w + 1];
        z += d[w + 2];
        ++count;
      }
      const a = pull[v] * count;
      const whole = count * (1 + (pull[v] === 0 ? kSpread : 0)) + a;
      d[3 * v] = (x + a * target[3 * v]) / whole;
      d[3 * v + 1] = (y + a * target[3 * v + 1]) / whole;
      d[3 * v + 2] = (z + a * target[3 * v + 2]) / whole;
    }
  }
}

/** Pieces go away from the middle of all, and away from what they were cut off. */
function movePieces(surface: Surface, normals: Float32Array, areas: Float32Array, rowOf: (piece: number) => number, rows: number,
                    size: number, out: Opening): void {
  const { positions: p, corners, slots, ids, flags, pieces } = surface;
  const sums = new Float64Array(8 * rows); // centre times area, area, normals of cut faces, their area
  for (let s = 0; s < slots; ++s) {
    if (ids[s] === kNone) continue;
    const row = 8 * rowOf(pieces[s]);
    for (let k = 0; k < 3; ++k) {
      const centre = (p[3 * corners[3 * s] + k] + p[3 * corners[3 * s + 1] + k] + p[3 * corners[3 * s + 2] + k]) / 3;
      sums[row + k] += areas[s] * centre;
      if (flags[s] & kCut) sums[row + 4 + k] += normals[3 * s + k];
    }
    sums[row + 3] += areas[s];
    if (flags[s] & kCut) sums[row + 7] += areas[s];
  }
  const middle = [0, 0, 0];
  let area = 0;
  for (let r = 0; r < rows; ++r) {
    for (let k = 0; k < 3; ++k) middle[k] += sums[8 * r + k];
    area += sums[8 * r + 3];
  }
  out.pieces = withRoom(out.pieces, 4 * rows).fill(0);
  for (let r = 0; r < rows; ++r) {
    const own = sums[8 * r + 3];
    if (own === 0) continue;
    const away = 0.11 * size * (sums[8 * r + 7] > 0 ? 1 / sums[8 * r + 7] : 0);
    for (let k = 0; k < 3; ++k) {
      out.pieces[4 * r + k] = 0.42 * (sums[8 * r + k] / own - middle[k] / area) - away * sums[8 * r + 4 + k];
    }
  }
  // An uncut body stays where it is, whatever its rounding.
  if (rows === 1) out.pieces.fill(0);
}
