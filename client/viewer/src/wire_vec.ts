import type { Vec3 } from "./messages";
import type { Vec3 as WireVec3 } from "./wire/incise/wire/vec3";

/** A vector of a message; one that is absent is zero. */
export const vec = (v: WireVec3 | null | undefined): Vec3 => (v ? [v.x(), v.y(), v.z()] : [0, 0, 0]);
