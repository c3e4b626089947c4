import type { Vec3 } from "./messages";

export interface Section {
  axis: number; // 0, 1, 2: the plane's normal is x, y, z
  side: number; // what lies on this side of the plane is left out: 1 or -1, along the axis
  share: number; // where the plane is, 0 to 1
}

const kBeyond = 0.25; // of the body's extent beyond either end: opened pieces are outside its box

/** The plane as (normal, offset): points with normal . p > offset are left out. */
export function planeOf({ axis, side, share }: Section, min: Vec3, max: Vec3): [number, number, number, number] {
  const at = min[axis] + (max[axis] - min[axis]) * (share * (1 + 2 * kBeyond) - kBeyond);
  const plane: [number, number, number, number] = [0, 0, 0, side * at];
  plane[axis] = side;
  return plane;
}

/** The axis nearest to the direction from the body to the eye. */
export function axisFacing(toEye: Vec3): number {
  const lengths = toEye.map(Math.abs);
  return lengths.indexOf(Math.max(...lengths));
}

/** The direction to the eye, mirrored at the plane: from there one sees the other half's side of the section. */
export function mirrored(toEye: Vec3, axis: number): Vec3 {
  const there: Vec3 = [...toEye];
  there[axis] = -there[axis];
  return there;
}

/** The side of the plane to leave out so that the section faces the eye. */
export function sideFacing(toEye: Vec3, axis: number): number {
  return toEye[axis] < 0 ? -1 : 1;
}
