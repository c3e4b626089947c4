import * as THREE from "three";
import type { Vec3 } from "./messages";

/**
 * The standard views, in the order of their keys: the direction from the body to the eye. z is up, the front is at -y.
 * Straight up and down leave open what is up in the picture: these two lean towards the front by a hair.
 */
export const kViews: Record<string, Vec3> = {
  front: [0, -1, 0],
  back: [0, 1, 0],
  left: [-1, 0, 0],
  right: [1, 0, 0],
  top: [0, -1e-4, 1],
  bottom: [0, -1e-4, -1],
  isometric: [1, -1, 1],
};

const kFlight_ms = 380;

/** three.js's spherical coordinates have y up. */
export function toSpherical(arm: THREE.Vector3): THREE.Spherical {
  return new THREE.Spherical().setFromVector3(new THREE.Vector3(arm.x, arm.z, -arm.y));
}

export function fromSpherical(at: THREE.Spherical): THREE.Vector3 {
  const arm = new THREE.Vector3().setFromSpherical(at);
  return arm.set(arm.x, -arm.z, arm.y);
}

/** Where the camera is and what it looks at. */
export interface CameraPlace {
  position: THREE.Vector3;
  target: THREE.Vector3;
}

/** The camera's way from one place to another, around the target and not through it. */
export class Flight {
  private readonly from: THREE.Spherical;
  private readonly to: THREE.Spherical;
  private readonly targets: [THREE.Vector3, THREE.Vector3];
  private readonly turn_rad: number; // the shorter way around

  constructor(
    from: CameraPlace,
    to: CameraPlace,
    private readonly began_ms: number,
  ) {
    this.targets = [from.target.clone(), to.target.clone()];
    this.from = toSpherical(from.position.clone().sub(from.target));
    this.to = toSpherical(to.position.clone().sub(to.target));
    const turn = this.to.theta - this.from.theta;
    this.turn_rad = turn - 2 * Math.PI * Math.round(turn / (2 * Math.PI));
  }

  /** Moves the camera to where it is now; true: it has arrived. */
  move(now_ms: number, { position, target }: CameraPlace): boolean {
    const t = Math.min(1, Math.max(0, (now_ms - this.began_ms) / kFlight_ms));
    const s = t * t * (3 - 2 * t);
    const { lerp } = THREE.MathUtils;
    target.lerpVectors(...this.targets, s);
    const { from, to } = this;
    const at = new THREE.Spherical(
      lerp(from.radius, to.radius, s),
      lerp(from.phi, to.phi, s),
      from.theta + s * this.turn_rad,
    );
    position.copy(fromSpherical(at)).add(target);
    return t === 1;
  }
}
