import { kNone, type Surface } from "./surface";

const kMostTriangles = 400_000; // of skin; beyond, the inside looks the same everywhere

/** The squared distance of p from the triangle whose corners are at t[at]. Ericson, Real-Time Collision Detection (2005), 5.1.5. */
function squaredDistance(t: Float32Array, at: number, px: number, py: number, pz: number): number {
  const ax = t[at],
    ay = t[at + 1],
    az = t[at + 2];
  const ux = t[at + 3] - ax,
    uy = t[at + 4] - ay,
    uz = t[at + 5] - az;
  const vx = t[at + 6] - ax,
    vy = t[at + 7] - ay,
    vz = t[at + 8] - az;
  const x = px - ax,
    y = py - ay,
    z = pz - az;
  const d1 = ux * x + uy * y + uz * z,
    d2 = vx * x + vy * y + vz * z;
  const uu = ux * ux + uy * uy + uz * uz,
    uv = ux * vx + uy * vy + uz * vz,
    vv = vx * vx + vy * vy + vz * vz;
  // d3 ... d6 of the book, at the other two corners.
  const d3 = d1 - uu,
    d4 = d2 - uv,
    d5 = d1 - uv,
    d6 = d2 - vv;
  let s = 0,
    r = 0;
  if (d1 <= 0 && d2 <= 0) {
    s = r = 0;
  } else if (d3 >= 0 && d4 <= d3) {
    s = 1;
  } else if (d6 >= 0 && d5 <= d6) {
    r = 1;
  } else {
    const vc = d1 * d4 - d3 * d2,
      vb = d5 * d2 - d1 * d6,
      va = d3 * d6 - d5 * d4;
    if (vc <= 0 && d1 >= 0 && d3 <= 0) {
      s = d1 / (d1 - d3);
    } else if (vb <= 0 && d2 >= 0 && d6 <= 0) {
      r = d2 / (d2 - d6);
    } else if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
      r = (d4 - d3) / (d4 - d3 + (d5 - d6));
      s = 1 - r;
    } else {
      s = vb / (va + vb + vc);
      r = vc / (va + vb + vc);
    }
  }
  const dx = x - s * ux - r * vx,
    dy = y - s * uy - r * vy,
    dz = z - s * uz - r * vz;
  return dx * dx + dy * dy + dz * dz;
}

/**
 * How deep below the skin places of the body at rest are. Cuts leave the skin where it is, so what it was when this was made
 * will do until the surface is replaced.
 */
export class SkinDepth {
  private readonly triangles: Float32Array; // 9 numbers each, at rest
  private readonly first = new Map<number, number>(); // by cell: an entry
  private readonly entries: number[] = []; // triangle, next entry or -1

  /** Deeper than `reach` is `reach`. */
  constructor(
    surface: Surface,
    readonly reach: number,
  ) {
    const skin: number[] = [];
    for (let slot = 0; slot < surface.slots; ++slot)
      if (surface.ids[slot] !== kNone && !(surface.flags[slot] & 1)) skin.push(slot);
    if (skin.length > kMostTriangles) skin.length = 0;
    this.triangles = new Float32Array(9 * skin.length);
    const corners = new Float32Array(9);
    for (const [i, slot] of skin.entries()) {
      surface.restCorners(slot, corners);
      this.triangles.set(corners, 9 * i);
      const low = [0, 1, 2].map((k) => this.cell(Math.min(corners[k], corners[3 + k], corners[6 + k])));
      const high = [0, 1, 2].map((k) => this.cell(Math.max(corners[k], corners[3 + k], corners[6 + k])));
      for (let x = low[0]; x <= high[0]; ++x)
        for (let y = low[1]; y <= high[1]; ++y)
          for (let z = low[2]; z <= high[2]; ++z) this.enter(this.key(x, y, z), i);
    }
  }

  private cell(x: number): number {
    return Math.floor(x / this.reach);
  }
  private key(x: number, y: number, z: number): number {
    return Math.imul(x, 73856093) ^ Math.imul(y, 19349663) ^ Math.imul(z, 83492791);
  }
  private enter(key: number, triangle: number): void {
    this.entries.push(triangle, this.first.get(key) ?? -1);
    this.first.set(key, this.entries.length - 2);
  }

  at(x: number, y: number, z: number): number {
    let least = this.reach * this.reach;
    const i = this.cell(x),
      j = this.cell(y),
      k = this.cell(z);
    for (let n = 0; n < 27; ++n) {
      const key = this.key(i + (n % 3) - 1, j + (((n / 3) | 0) % 3) - 1, k + ((n / 9) | 0) - 1);
      for (let e = this.first.get(key) ?? -1; e >= 0; e = this.entries[e + 1])
        least = Math.min(least, squaredDistance(this.triangles, 9 * this.entries[e], x, y, z));
    }
    return Math.sqrt(least);
  }
}
