import * as THREE from "three";

const kHalfWidth = 0.0011; // times the body's size
const kSkinColour = 0xffe9dc,
  kCutColour = 0x39d0c0;
const kDarkest = 0.35; // of a line in a section that the light does not reach
const kLift = 0.0006; // towards the side that is left out, so that the section's face does not cover them

/** Triangles as they are shown: 9 numbers a slot, and whether a cut made them. */
export interface ShownTriangles {
  slots: number;
  corners: (slot: number, out: Float64Array) => boolean; // false: the slot is free
  isCut: (slot: number) => boolean;
}

/** Segments (6 numbers) along which triangles cross the plane of points with normal . p = offset. */
export function crossings(
  triangles: ShownTriangles,
  [nx, ny, nz, offset]: readonly number[],
  cross: (segment: Float64Array, cut: boolean) => void,
): void {
  const p = new Float64Array(9),
    height = new Float64Array(3),
    segment = new Float64Array(6);
  for (let slot = 0; slot < triangles.slots; ++slot) {
    if (!triangles.corners(slot, p)) continue;
    for (let k = 0; k < 3; ++k) height[k] = nx * p[3 * k] + ny * p[3 * k + 1] + nz * p[3 * k + 2] - offset;
    let ends = 0;
    for (let k = 0; k < 3; ++k) {
      const l = (k + 1) % 3;
      if (height[k] < 0 === height[l] < 0) continue;
      const t = height[k] / (height[k] - height[l]);
      for (let i = 0; i < 3; ++i) segment[3 * ends + i] = p[3 * k + i] + t * (p[3 * l + i] - p[3 * k + i]);
      ++ends;
    }
    if (ends === 2) cross(segment, triangles.isCut(slot));
  }
}

/** The lines along which a section meets the body's skin and its cuts, as ribbons in its plane. */
export class SectionLines {
  readonly group = new THREE.Group();
  private readonly skin = this.ribbons(kSkinColour);
  private readonly cuts = this.ribbons(kCutColour);

  show(triangles: ShownTriangles | null, plane: readonly number[], bodySize_m: number): void {
    this.group.visible = triangles !== null;
    if (!triangles) return;
    const normal = new THREE.Vector3(plane[0], plane[1], plane[2]);
    const lines = { skin: [] as number[], cuts: [] as number[] };
    const a = new THREE.Vector3(),
      b = new THREE.Vector3(),
      side = new THREE.Vector3();
    const lift = normal.clone().multiplyScalar(kLift * bodySize_m);
    crossings(triangles, plane, (segment, cut) => {
      a.fromArray(segment).add(lift);
      b.fromArray(segment, 3).add(lift);
      side
        .subVectors(b, a)
        .cross(normal)
        .setLength(kHalfWidth * bodySize_m);
      const corners = [a.clone().add(side), a.clone().sub(side), b.clone().add(side), b.clone().sub(side)];
      for (const k of [0, 1, 2, 2, 1, 3]) (cut ? lines.cuts : lines.skin).push(...corners[k].toArray());
    });
    for (const [mesh, positions] of [
      [this.skin, lines.skin],
      [this.cuts, lines.cuts],
    ] as const) {
      mesh.geometry.dispose();
      mesh.geometry = new THREE.BufferGeometry();
      mesh.geometry.setAttribute("position", new THREE.Float32BufferAttribute(positions, 3));
    }
  }

  /** As bright as the section's face is, with light from there (unit). */
  light([x, y, z]: readonly number[], towards: THREE.Vector3): void {
    const facing = Math.max(0, x * towards.x + y * towards.y + z * towards.z);
    const bright = kDarkest + (1 - kDarkest) * facing;
    for (const [mesh, colour] of [
      [this.skin, kSkinColour],
      [this.cuts, kCutColour],
    ] as const)
      mesh.material.color.setHex(colour).multiplyScalar(bright);
  }

  private ribbons(colour: number): THREE.Mesh<THREE.BufferGeometry, THREE.MeshBasicMaterial> {
    const mesh = new THREE.Mesh(
      new THREE.BufferGeometry(),
      new THREE.MeshBasicMaterial({ color: colour, side: THREE.DoubleSide }),
    );
    mesh.frustumCulled = false;
    this.group.add(mesh);
    return mesh;
  }
}
