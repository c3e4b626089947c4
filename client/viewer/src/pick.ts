import * as THREE from "three";
import type { BodyMesh } from "./body_mesh";
import type { Vec3 } from "./messages";

/** A place on the surface that goes where its triangle goes: the triangle's half-face and barycentric weights. */
export interface Place {
  halfFace: number;
  slot: number; // of the triangle; another one after the whole surface was sent again
  weights: Vec3;
}

export interface Hit extends Place {
  distance: number; // in units of the ray's direction
  isCut: boolean;
}

/**
 * Where a ray meets the front of the body as it is drawn: opened by `open`, without what lies beyond the plane of a
 * section. Null: it misses, or meets the inside that a section shows. O(triangles).
 */
export function pick(body: BodyMesh, open: number, plane: readonly number[] | null, ray: THREE.Ray): Hit | null {
  const shown = body.shown(open);
  const p = new Float64Array(9);
  const [a, b, c, at] = [0, 1, 2, 3].map(() => new THREE.Vector3());
  const normal = new THREE.Vector3(...(plane ?? [0, 0, 0]).slice(0, 3));
  let nearest: { slot: number; distance: number; front: boolean; weights: Vec3 } | null = null;
  for (let slot = 0; slot < shown.slots; ++slot) {
    if (!shown.corners(slot, p)) continue;
    if (!ray.intersectTriangle(a.fromArray(p), b.fromArray(p, 3), c.fromArray(p, 6), false, at)) continue;
    if (plane && normal.dot(at) > plane[3]) continue;
    const distance = at.distanceTo(ray.origin) / ray.direction.length();
    if (nearest && distance >= nearest.distance) continue;
    const weights = THREE.Triangle.getBarycoord(at, a, b, c, new THREE.Vector3());
    if (!weights) continue;
    const front = b.sub(a).cross(c.sub(a)).dot(ray.direction) < 0;
    nearest = { slot, distance, front, weights: weights.toArray() };
  }
  if (!nearest?.front) return null;
  const { slot, distance, weights } = nearest;
  return { slot, distance, weights, halfFace: body.ids[slot], isCut: shown.isCut(slot) };
}

/** Finds the place's triangle again; false: it is gone. */
export function follow(body: BodyMesh, place: Place): boolean {
  if (body.ids[place.slot] !== place.halfFace) place.slot = body.ids.indexOf(place.halfFace);
  return place.slot >= 0;
}

/** Where the place is while the body is opened by `open`. */
export function placeOn(body: BodyMesh, { slot, weights }: Place, open: number): THREE.Vector3 {
  const p = new Float64Array(9);
  body.shown(open).corners(slot, p);
  const at = new THREE.Vector3();
  weights.forEach((weight, k) => {
    at.addScaledVector(new THREE.Vector3().fromArray(p, 3 * k), weight);
  });
  return at;
}
