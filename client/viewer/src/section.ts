import type { Vec3 } from "./messages";

export interface Section {
  normal: Vec3; // unit: what lies beyond the plane on this side is left out
  share: number; // where the plane is along its normal, 0 to 1
}

const kBeyond = 0.25; // of the body's extent beyond either end: opened pieces are outside its box

const dot = (a: Vec3, b: Vec3) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** Where a share of 0 and one of 1 are along the normal, metres. */
function range(normal: Vec3, min: Vec3, max: Vec3): [number, number] {
  let low = 0,
    high = 0;
  for (let k = 0; k < 3; ++k) {
    const a = normal[k] * min[k],
      b = normal[k] * max[k];
    low += Math.min(a, b);
    high += Math.max(a, b);
  }
  const beyond = kBeyond * (high - low);
  return [low - beyond, high + beyond];
}

/** The plane as (normal, offset): points with normal . p > offset are left out. */
export function planeOf({ normal, share }: Section, min: Vec3, max: Vec3): [number, number, number, number] {
  const [low, high] = range(normal, min, max);
  return [...normal, low + share * (high - low)];
}

/** The section with this normal through a point, or as near to it as a section may be. */
export function through(point: Vec3, normal: Vec3, min: Vec3, max: Vec3): Section {
  const [low, high] = range(normal, min, max);
  return { normal, share: Math.min(1, Math.max(0, (dot(normal, point) - low) / (high - low))) };
}

/** Across the axis, so that the section faces the eye. */
export function across(axis: number, toEye: Vec3): Vec3 {
  const normal: Vec3 = [0, 0, 0];
  normal[axis] = toEye[axis] < 0 ? -1 : 1;
  return normal;
}

/** The axis that the normal lies along; -1: none. */
export function axisOf(normal: Vec3): number {
  return normal.findIndex((x) => Math.abs(x) > 1 - 1e-6);
}

/** The axis nearest to the direction from the body to the eye. */
export function axisFacing(toEye: Vec3): number {
  const lengths = toEye.map(Math.abs);
  return lengths.indexOf(Math.max(...lengths));
}

/** The same plane, with the other half left out. */
export function otherHalf({ normal: [x, y, z], share }: Section): Section {
  return { normal: [0 - x, 0 - y, 0 - z], share: 1 - share };
}

/** The direction to the eye, mirrored at the plane: from there one sees the other half's side of the section. */
export function mirrored(toEye: Vec3, normal: Vec3): Vec3 {
  const twice = 2 * dot(toEye, normal);
  return [toEye[0] - twice * normal[0], toEye[1] - twice * normal[1], toEye[2] - twice * normal[2]];
}
