import * as THREE from "three";
import type { Marks } from "./marks";
import { type Section, through } from "./section";
import type { Stage } from "./stage";

const kRadius = 0.3; // of the ring, times the body's size
const kArrow = 0.1; // likewise, to either side of the plane
const kReach_px = 14; // how near to a handle the pointer has it
const kTouchReach_px = 28;
const kShortest = 0.3; // a direction that is seen shorter than this share of its length is not dragged along
const kRingSegments = 48;

type Part = "move" | "turn";

interface Grip {
  part: Part;
  pointer: number;
  x: number; // where it was taken, pixels of the page
  y: number;
  plane: PlaneFrame; // as it was then
}

interface PlaneFrame {
  normal: THREE.Vector3;
  foot: THREE.Vector3; // the handle's middle
  knob: THREE.Vector3; // unit, in the plane: where on the ring the knob is
}

/**
 * Two handles on a section's plane: one in its middle moves it along its normal, one on a ring around that turns it, as if
 * the ring were on a ball that the pointer rolls.
 */
export class SectionHandle {
  private grip: Grip | null = null;
  private readonly pivot = new THREE.Vector3(); // the middle as it was left
  private left: { normal: THREE.Vector3; body: THREE.Vector3 } | null = null; // the plane's, and the body's middle then
  private turned: THREE.Vector3 | null = null; // the knob, while it is dragged

  constructor(
    private readonly canvas: HTMLElement,
    private readonly stage: Stage,
    private readonly change: (section: Section) => void,
  ) {
    stage.marks.tools.push((marks) => this.draw(marks));
    // Before the tools get it: what begins on a handle neither cuts nor turns the body.
    const first = { capture: true };
    document.addEventListener("pointerdown", (e) => this.onDown(e), first);
    document.addEventListener("pointermove", (e) => this.onMove(e), first);
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"] as const)
      canvas.addEventListener(end, (e) => this.letGo(e.pointerId, e));
  }

  /** Lets go, and puts the plane back to where it was taken. False: nothing was dragged. */
  cancel(): boolean {
    if (!this.grip) return false;
    const { foot, normal } = this.grip.plane;
    this.show(foot, normal);
    this.letGo(this.grip.pointer);
    return true;
  }

  /** The section is off. */
  drop(): void {
    this.grip = this.turned = null;
    this.mark(null);
  }

  /** Moves the plane along its normal, by this share of the body's size. */
  move(by: number): void {
    const plane = this.frame();
    if (plane) this.show(plane.foot.addScaledVector(plane.normal, by * this.stage.bodySize_m), plane.normal);
  }

  /** Turns the plane about the picture's upward and rightward directions, radians. */
  turn(right: number, down: number): void {
    const plane = this.frame();
    if (plane) this.show(plane.foot, plane.normal.applyQuaternion(this.rolled(right, down)));
  }

  private show(point: THREE.Vector3, normal: THREE.Vector3): void {
    const { min, max } = this.stage;
    this.pivot.copy(point);
    this.left = { normal, body: this.stage.centre.clone() };
    this.change(through(point.toArray(), normal.normalize().toArray(), min, max));
  }

  /** The plane as it is; null: there is no section. */
  private frame(): PlaneFrame | null {
    const { plane, centre, camera } = this.stage;
    if (!plane) return null;
    const normal = new THREE.Vector3(plane[0], plane[1], plane[2]);
    // Where it was left, or if somebody else has put the plane here, before the body's middle.
    const near = this.left?.normal.equals(normal) && this.left.body.equals(centre) ? this.pivot : centre;
    const foot = near.clone().addScaledVector(normal, plane[3] - normal.dot(near));
    // To the picture's right, unless the plane is seen from its edge there.
    const knob = new THREE.Vector3();
    for (const column of [0, 1]) {
      knob.setFromMatrixColumn(camera.matrixWorld, column).projectOnPlane(normal);
      if (knob.length() > kShortest) break;
    }
    return { normal, foot, knob: knob.normalize() };
  }

  private rolled(right: number, down: number): THREE.Quaternion {
    const { matrixWorld } = this.stage.camera;
    const axis = new THREE.Vector3().setFromMatrixColumn(matrixWorld, 1).multiplyScalar(right);
    axis.addScaledVector(new THREE.Vector3().setFromMatrixColumn(matrixWorld, 0), down);
    const angle = axis.length();
    return new THREE.Quaternion().setFromAxisAngle(angle > 0 ? axis.divideScalar(angle) : axis.set(1, 0, 0), angle);
  }

  private places(): { middle: THREE.Vector3; knob: THREE.Vector3 } | null {
    const frame = this.frame();
    if (!frame) return null;
    const radius = kRadius * this.stage.bodySize_m;
    return { middle: frame.foot, knob: frame.foot.clone().addScaledVector(this.turned ?? frame.knob, radius) };
  }

  /** The handle under the pointer. */
  private partAt({ clientX: x, clientY: y, pointerType }: PointerEvent): Part | null {
    const places = this.places();
    if (!places) return null;
    const reach = pointerType === "touch" ? kTouchReach_px : kReach_px;
    const near = (place: THREE.Vector3) => {
      const at = this.stage.marks.onScreen(place);
      return at !== null && Math.hypot(at[0] - x, at[1] - y) < reach;
    };
    return near(places.knob) ? "turn" : near(places.middle) ? "move" : null;
  }

  private onDown(e: PointerEvent): void {
    if (e.target !== this.canvas || this.grip || e.button !== 0 || !e.isPrimary) return;
    const part = this.partAt(e);
    if (!part) return;
    e.stopPropagation();
    this.grip = { part, pointer: e.pointerId, x: e.clientX, y: e.clientY, plane: this.frame()! };
    this.canvas.setPointerCapture(e.pointerId);
    this.mark(part);
  }

  private onMove(e: PointerEvent): void {
    if (e.target !== this.canvas) return;
    const { grip } = this;
    if (!grip) return this.mark(e.buttons === 0 ? this.partAt(e) : null);
    if (e.pointerId !== grip.pointer) return;
    e.stopPropagation();
    const dx = e.clientX - grip.x,
      dy = e.clientY - grip.y;
    const { normal, foot, knob } = grip.plane;
    if (grip.part === "move") {
      this.show(foot.clone().addScaledVector(normal, this.along(grip.plane, dx, dy)), normal.clone());
    } else {
      const radius_px = kRadius * this.stage.bodySize_m * this.pixelsPerMetre(foot);
      const turn = this.rolled(dx / radius_px, dy / radius_px);
      this.turned = knob.clone().applyQuaternion(turn);
      this.show(foot, normal.clone().applyQuaternion(turn));
    }
  }

  /** How far along the normal (dx, dy) pixels are. A plane that faces the eye comes nearer with a drag downwards. */
  private along({ foot, normal }: PlaneFrame, dx: number, dy: number): number {
    const scale = this.pixelsPerMetre(foot);
    const { marks, bodySize_m, toEye } = this.stage;
    const from = marks.onScreen(foot),
      to = marks.onScreen(foot.clone().addScaledVector(normal, kArrow * bodySize_m));
    if (!from || !to) return 0;
    const s = [(to[0] - from[0]) / (kArrow * bodySize_m), (to[1] - from[1]) / (kArrow * bodySize_m)];
    const square = s[0] * s[0] + s[1] * s[1];
    if (square > (kShortest * scale) ** 2) return (dx * s[0] + dy * s[1]) / square;
    return (dy / scale) * Math.sign(normal.dot(new THREE.Vector3(...toEye)) || 1);
  }

  private pixelsPerMetre(at: THREE.Vector3): number {
    const { camera } = this.stage;
    const depth = at.clone().applyMatrix4(camera.matrixWorldInverse).z;
    return this.canvas.clientHeight / (2 * Math.tan((camera.fov * Math.PI) / 360) * Math.max(1e-6, -depth));
  }

  private letGo(pointer: number, at?: PointerEvent): void {
    if (this.grip?.pointer !== pointer) return;
    this.grip = null;
    this.turned = null;
    this.mark(at?.pointerType === "mouse" ? this.partAt(at) : null);
  }

  /** For the cursor, and so that the blade's preview keeps away. */
  private mark(part: Part | null): void {
    const before = document.body.dataset.handle;
    if (before === (part ?? undefined)) return;
    if (part) document.body.dataset.handle = part;
    else delete document.body.dataset.handle;
    this.stage.marks.draw();
  }

  private draw(marks: Marks): void {
    const frame = this.frame(),
      places = this.places();
    if (!frame || !places) return;
    const { bodySize_m } = this.stage;
    const { foot, normal } = frame;
    const knob = this.turned ?? frame.knob;
    const other = new THREE.Vector3().crossVectors(normal, knob);
    const ring: THREE.Vector3[] = [];
    for (let i = 0; i <= kRingSegments; ++i) {
      const angle = (2 * Math.PI * i) / kRingSegments;
      const at = foot.clone().addScaledVector(knob, kRadius * bodySize_m * Math.cos(angle));
      ring.push(at.addScaledVector(other, kRadius * bodySize_m * Math.sin(angle)));
    }
    marks.path(ring, 1);
    const reach = kArrow * bodySize_m;
    marks.line(foot.clone().addScaledVector(normal, -reach), foot.clone().addScaledVector(normal, reach), 2);
    marks.dot(places.middle, 6);
    marks.dot(places.knob, 6, false);
    const hot = document.body.dataset.handle as Part | undefined;
    if (hot && !this.grip) marks.label(hot === "turn" ? places.knob : places.middle, hot === "turn" ? "Turn" : "Move");
  }
}
