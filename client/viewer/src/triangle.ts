/**
 * Writes the normal of the triangle whose corners are at p[a], p[b] and p[c] (x, y and z from there on) to out[at]; its
 * length, which is returned, is twice the triangle's area.
 */
export function faceNormal(
  p: Float32Array | Float64Array,
  a: number,
  b: number,
  c: number,
  out: Float32Array | Float64Array,
  at: number,
): number {
  const ux = p[b] - p[a],
    uy = p[b + 1] - p[a + 1],
    uz = p[b + 2] - p[a + 2];
  const vx = p[c] - p[a],
    vy = p[c + 1] - p[a + 1],
    vz = p[c + 2] - p[a + 2];
  const x = uy * vz - uz * vy,
    y = uz * vx - ux * vz,
    z = ux * vy - uy * vx;
  out[at] = x;
  out[at + 1] = y;
  out[at + 2] = z;
  return Math.hypot(x, y, z);
}
