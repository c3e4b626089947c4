import { kWall, sidesOf } from "./cut_sides";
import { kNone, type Surface, withRoom } from "./surface";
import { faceNormal } from "./triangle";

// How the body is shown opened: a displacement for the lips of cuts that stop inside the tissue, and one for each piece
// that has come free. Only what is drawn moves; positions and hashes stay.

const kCut = 1;
const kRounds = 70;
const kSpread = 0.03; // the share that a vertex away from the cut loses: the reach is about 1 / sqrt(kSpread) edges
const kLift = 0.085; // of the body's size: how far a lip is pulled
const kPull = 0.12; // weight of the pull on a wall's vertex, away from the gap
const kHold = 1e3; // weight that holds a vertex on the crack front
const kCancels = 0.5; // a vertex whose normals sum to less than this share of their areas has both sides of the gap
const kRings = 14; // of vertices around a lip that move with it

export interface Opening {
  /** 3 a vertex id, metres: its displacement when fully opened. */
  lips: Float32Array;
  /** 4 a row of a piece: x, y, z in metres, and 0. */
  pieces: Float32Array;
  /** One side, m^2. */
  cutArea_m2: number;
}

/**
 * Lips: over the surface's graph, d solves a screened Laplace equation in which each vertex on one side of a cut that
 * stops in the tissue is pulled back along that cut's normal, and the crack front, where both sides share their
 * vertices and so the normals cancel, is held. Faces of a cut that went through are not pulled: the piece moves as a
 * whole.
 *
 * Time: kRounds times the vertices near cuts. Thread: the worker's.
 */
export function computeOpening(
  surface: Surface,
  rowOf: (piece: number) => number,
  rows: number,
  size: number,
  out: Opening,
): void {
  out.lips = withRoom(out.lips, 3 * surface.head.length).fill(0);
  const faces = measureFaces(surface);
  out.cutArea_m2 = faces.cutArea / 2;
  movePieces(surface, faces.normals, faces.areas, rowOf, rows, size, out);
  if (faces.cut.length === 0) return;
  const lips = findLips(surface, faces, kLift * size);
  reachOut(surface, lips);
  relax(surface, lips.near, lips.target, lips.pull, out.lips);
}

export interface Faces {
  normals: Float32Array; // 3 a slot; its length is the face's area
  areas: Float32Array; // a slot
  cut: number[]; // slots of cut faces
  cutArea: number; // of both sides
}

export function measureFaces({ positions: p, corners, slots, ids, flags }: Surface): Faces {
  const faces: Faces = { normals: new Float32Array(3 * slots), areas: new Float32Array(slots), cut: [], cutArea: 0 };
  for (let s = 0; s < slots; ++s) {
    if (ids[s] === kNone) continue;
    const at = 3 * s;
    faces.areas[s] = faceNormal(p, 3 * corners[at], 3 * corners[at + 1], 3 * corners[at + 2], faces.normals, at) / 2;
    for (let k = 0; k < 3; ++k) faces.normals[at + k] /= 2;
    if (!(flags[s] & kCut)) continue;
    faces.cut.push(s);
    faces.cutArea += faces.areas[s];
  }
  return faces;
}

interface Lips {
  target: Float32Array; // 3 a vertex
  pull: Float32Array; // a vertex; 0: it follows its neighbours; kPull: a lip; kHold: the crack front
  near: number[]; // vertices that may move
  known: Uint8Array; // a vertex: it is in near
}

/** Vertices on the walls of cuts that stop in the tissue, and where they are pulled. */
function findLips(surface: Surface, faces: Faces, lift: number): Lips {
  const { corners, head, next } = surface;
  const { normals, areas } = faces;
  const sides = sidesOf(surface, faces);
  const vertices = head.length;
  const lips: Lips = {
    target: new Float32Array(3 * vertices),
    pull: new Float32Array(vertices),
    near: [],
    known: new Uint8Array(vertices),
  };
  for (const face of faces.cut) {
    if (sides[face] !== kWall) continue;
    for (let k = 0; k < 3; ++k) {
      const v = corners[3 * face + k];
      if (lips.known[v]) continue;
      lips.known[v] = 1;
      lips.near.push(v);
      let x = 0,
        y = 0,
        z = 0,
        area = 0;
      for (let c = head[v]; c !== kNone; c = next[c]) {
        const s = (c / 3) | 0;
        if (sides[s] !== kWall) continue;
        x += normals[3 * s];
        y += normals[3 * s + 1];
        z += normals[3 * s + 2];
        area += areas[s];
      }
      const length = Math.hypot(x, y, z);
      const front = length < kCancels * area;
      lips.pull[v] = front ? kHold : kPull;
      if (!front) lips.target.set([(-lift * x) / length, (-lift * y) / length, (-lift * z) / length], 3 * v);
    }
  }
  return lips;
}

/** Adds the vertices within reach of the lips. */
function reachOut({ corners, head, next }: Surface, { near, known }: Lips): void {
  for (let from = 0, ring = 0; ring < kRings; ++ring) {
    const end = near.length;
    for (; from < end; ++from) {
      for (let c = head[near[from]]; c !== kNone; c = next[c]) {
        const s = 3 * ((c / 3) | 0);
        for (let k = 0; k < 3; ++k) {
          const w = corners[s + k];
          if (known[w]) continue;
          known[w] = 1;
          near.push(w);
        }
      }
    }
  }
}

function relax(surface: Surface, near: number[], target: Float32Array, pull: Float32Array, d: Float32Array): void {
  const { corners, head, next } = surface;
  for (let round = 0; round < kRounds; ++round) {
    for (let i = 0; i < near.length; ++i) {
      const v = near[round & 1 ? near.length - 1 - i : i];
      let x = 0,
        y = 0,
        z = 0,
        count = 0;
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

/** Moves pieces away from the centre of all, and away from what they were cut off. */
function movePieces(
  surface: Surface,
  normals: Float32Array,
  areas: Float32Array,
  rowOf: (piece: number) => number,
  rows: number,
  size: number,
  out: Opening,
): void {
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
  // An uncut body stays exactly where it is.
  if (rows === 1) out.pieces.fill(0);
}
