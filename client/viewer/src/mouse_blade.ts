import * as THREE from "three";
import type { BladeFacts, Vec3 } from "./messages";
import type { Stage } from "./stage";

const kStep_ms = 4; // between two poses, where pointer events are farther apart
const kStart_px = 3; // shorter ones are clicks, not strokes
const kStill_ms = 60; // a resting mouse repeats its pose this often: a longer gap would end the stroke
const kLongestStep_ms = 30; // between two poses of a stroke
const kSafeSpeed = 0.4; // of the speed above which the server begins a new stroke

interface Sample {
  time_ms: number; // absolute
  x: number; // normalised device coordinates
  y: number;
}
interface Pose {
  time_ms: number;
  heel: THREE.Vector3;
  tip: THREE.Vector3;
}

export interface MouseBladeEvents {
  /** 9 numbers a pose. */
  poses(poses: Float64Array): void;
  moved(heel: Vec3, tip: Vec3, cuts: boolean): void;
  /** A stroke was tried while the blade is disabled. */
  refused(): void;
  strokeBegan(): void;
  /** Where the pointer of a stroke is now. */
  aimed(ray: THREE.Ray): void;
  /** The pointer moved over the picture, or left it, without a stroke. */
  hovered(): void;
  /** sent: the server was sent poses of it. */
  strokeEnded(sent: boolean): void;
}

/**
 * Turns the pointer's path over the picture into the path of a blade along the line of sight: a line drawn on the
 * body is cut straight away from the eye. `depth_m` is how far its tip goes below the skin; null: right through. A
 * section's plane is skin, too, and what it hides is not there.
 */
export class MouseBlade {
  facts: BladeFacts | null = null;
  depth_m: number | null = null;
  tilt_rad = 0;
  enabled = false;

  private pointer = -1;
  private down: Sample | null = null;
  private engaged = false;
  private samples: Sample[] = []; // the last three
  private waitingForSkin: Sample[] = []; // until the stroke first meets the body, if the depth is limited
  private reach = NaN; // distance from the eye to the skin, of the last ray that met it
  private last: Pose | null = null;
  private sourceTime_ms = 0;
  private lastSent_ms = 0;
  private lastEvent: Sample | null = null;
  private batch: number[] = [];
  private hover: Sample | null = null; // a pointer with no button pressed
  private readonly ray = new THREE.Raycaster();

  constructor(
    private readonly canvas: HTMLElement,
    private readonly stage: Stage,
    private readonly events: MouseBladeEvents,
  ) {
    canvas.addEventListener("pointerdown", (e) => this.onDown(e));
    canvas.addEventListener("pointermove", (e) => this.onMove(e));
    canvas.addEventListener("pointerup", (e) => this.onUp(e));
    canvas.addEventListener("pointercancel", (e) => this.onUp(e));
    canvas.addEventListener("lostpointercapture", (e) => this.onUp(e));
    canvas.addEventListener("pointerleave", () => this.setHover(null));
  }

  get cutting(): boolean {
    return this.engaged;
  }

  /** Ends the stroke, if there is one. */
  cancel(): void {
    this.finish();
    this.pointer = -1;
    this.down = null;
  }

  /** To be called every frame: repeats the pose of a resting blade. */
  tick(): void {
    const now = performance.timeOrigin + performance.now();
    if (this.engaged && this.lastEvent && now - this.lastSent_ms > kStill_ms) {
      this.advance({ ...this.lastEvent, time_ms: now });
      this.flush();
    }
  }

  private onDown(event: PointerEvent): void {
    if (event.button !== 0) return;
    if (!this.enabled || !this.facts) return this.events.refused();
    if (this.pointer >= 0) return this.cancel(); // a second finger: this is a turn
    if (event.pointerType === "touch" && !event.isPrimary) return;
    this.setHover(null);
    this.pointer = event.pointerId;
    this.canvas.setPointerCapture(event.pointerId);
    this.down = this.sample(event);
    this.samples = [];
    this.waitingForSkin = [];
    this.reach = NaN;
    this.last = null;
  }

  /** The blade as it would enter under the pointer, and the place on the skin; null: there is none. */
  preview(): { heel: THREE.Vector3; entry: THREE.Vector3; tip: THREE.Vector3 } | null {
    if (!this.hover || !this.enabled || !this.facts || this.engaged) return null;
    this.ray.setFromCamera(new THREE.Vector2(this.hover.x, this.hover.y), this.stage.camera);
    const { body, bodySize_m } = this.stage;
    const { origin, direction } = this.ray.ray;
    const reach = body.raycast(origin, direction);
    if (Number.isNaN(reach)) return null;
    const { heel, tip } = this.poseAt(this.hover, reach);
    // A tilted blade enters beside the pointer.
    const along = tip.clone().sub(heel).normalize();
    const before = tip.clone().addScaledVector(along, -3 * bodySize_m);
    const way = this.tilt_rad === 0 ? NaN : body.raycast(before, along);
    const entry = Number.isNaN(way)
      ? origin.clone().addScaledVector(direction, reach)
      : before.addScaledVector(along, way);
    return { heel, entry, tip };
  }

  private setHover(event: PointerEvent | null): void {
    const was = this.hover !== null;
    this.hover = event && event.buttons === 0 && event.pointerType !== "touch" ? this.sample(event) : null;
    if (was || this.hover) this.events.hovered();
  }

  private onMove(event: PointerEvent): void {
    if (!this.down) this.setHover(event);
    if (event.pointerId !== this.pointer || !this.down) return;
    const all = event.getCoalescedEvents?.() ?? [];
    const samples = (all.length > 0 ? all : [event]).map((e) => this.sample(e));
    const last = samples[samples.length - 1];
    if (!this.engaged) {
      const dx = ((last.x - this.down.x) * this.canvas.clientWidth) / 2;
      const dy = ((last.y - this.down.y) * this.canvas.clientHeight) / 2;
      if (Math.hypot(dx, dy) < kStart_px) return;
      this.engaged = true;
      this.sourceTime_ms = Math.max(this.sourceTime_ms + 1, this.down.time_ms);
      this.events.strokeBegan();
      this.advance(this.down);
    }
    // One ray for each event that the page gets, not for each sample in it.
    this.findSkin(last);
    this.events.aimed(this.ray.ray);
    for (const sample of samples) this.advance(sample);
    this.flush();
  }

  private onUp(event: PointerEvent): void {
    if (event.pointerId !== this.pointer) return;
    this.pointer = -1;
    this.down = null;
    this.finish();
  }

  private finish(): void {
    if (!this.engaged) return;
    const samples = this.samples;
    if (samples.length > 1) this.between(samples[samples.length - 2], samples[samples.length - 1], null);
    this.engaged = false;
    if (this.last) this.put({ ...this.last, time_ms: this.last.time_ms + 1 }, 0);
    this.flush();
    this.samples = [];
    this.lastEvent = null;
    this.events.strokeEnded(this.last !== null);
  }

  private sample(event: PointerEvent): Sample {
    const box = this.canvas.getBoundingClientRect();
    return {
      time_ms: performance.timeOrigin + event.timeStamp,
      x: (2 * (event.clientX - box.left)) / box.width - 1,
      y: 1 - (2 * (event.clientY - box.top)) / box.height,
    };
  }

  private findSkin(at: Sample): void {
    this.ray.setFromCamera(new THREE.Vector2(at.x, at.y), this.stage.camera);
    const distance = this.stage.body.raycast(this.ray.ray.origin, this.ray.ray.direction);
    if (Number.isNaN(distance)) return;
    // The distance jumps where one part is in front of another; the blade must not.
    this.reach = Number.isNaN(this.reach) ? distance : this.reach + 0.5 * (distance - this.reach);
  }

  /** Takes the next sample; poses go out up to the one before it, whose neighbours are known then. */
  private advance(sample: Sample): void {
    this.lastEvent = sample;
    if ((this.depth_m !== null || this.stage.plane) && Number.isNaN(this.reach)) {
      this.waitingForSkin = [sample]; // only the last one before the body is kept
      return;
    }
    for (const early of this.waitingForSkin.splice(0)) this.advance(early);
    const samples = this.samples;
    if (samples.length > 0 && sample.time_ms <= samples[samples.length - 1].time_ms) {
      sample.time_ms = samples[samples.length - 1].time_ms + 0.01;
    }
    samples.push(sample);
    if (samples.length === 1) this.put(this.poseAt(sample), this.buttons());
    if (samples.length >= 3) this.between(samples[samples.length - 3], samples[samples.length - 2], sample);
    if (samples.length > 4) samples.shift();
  }

  /** Poses after `a` up to `b`, on a cubic through the samples around them (Catmull and Rom 1974, with their times). */
  private between(a: Sample, b: Sample, after: Sample | null): void {
    const i = this.samples.indexOf(a);
    const before = i > 0 ? this.samples[i - 1] : null;
    const span = b.time_ms - a.time_ms;
    const slope = (p: Sample | null, q: Sample | null, k: "x" | "y") =>
      p && q && q.time_ms > p.time_ms ? ((q[k] - p[k]) / (q.time_ms - p.time_ms)) * span : b[k] - a[k];
    const steps = Math.max(1, Math.min(64, Math.round(span / kStep_ms)));
    for (let n = 1; n <= steps; ++n) {
      const t = n / steps;
      const along = (k: "x" | "y") => {
        const m0 = slope(before ?? a, b, k),
          m1 = slope(a, after ?? b, k);
        return (
          (2 * t * t * t - 3 * t * t + 1) * a[k] +
          (t * t * t - 2 * t * t + t) * m0 +
          (3 * t * t - 2 * t * t * t) * b[k] +
          (t * t * t - t * t) * m1
        );
      };
      this.put(this.poseAt({ time_ms: a.time_ms + t * span, x: along("x"), y: along("y") }), this.buttons());
    }
  }

  private buttons(): number {
    const button = this.facts?.engageButton ?? 0;
    return this.engaged && button >= 0 ? 1 << button : 0;
  }

  private poseAt(sample: Sample, reach = this.reach): Pose {
    const facts = this.facts!;
    const camera = this.stage.camera;
    this.ray.setFromCamera(new THREE.Vector2(sample.x, sample.y), camera);
    const { origin, direction } = this.ray.ray;
    const length = new THREE.Vector3(...facts.tip).distanceTo(new THREE.Vector3(...facts.heel));
    const middle = this.stage.centre.clone().sub(origin).dot(direction);
    const skin = Number.isNaN(reach) ? middle : reach;
    const along = direction.clone();
    if (this.tilt_rad !== 0)
      along.applyAxisAngle(new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 1), this.tilt_rad);
    const pivot = origin.clone().addScaledVector(direction, this.depth_m === null ? middle : skin);
    // Right through: the blade's middle in the body's middle, as far as its length allows.
    const below = this.withinSection(this.depth_m === null ? length / 2 : this.depth_m, length, pivot, along);
    const tip = pivot.clone().addScaledVector(along, below);
    const heel = tip.clone().addScaledVector(along, -length);
    return { time_ms: sample.time_ms, heel, tip };
  }

  /**
   * How far below the pivot the tip goes, so that the edge is on the side of a section's plane that is drawn. A blade
   * that goes in from the hidden side and not right through keeps its depth, and has the rest of its edge there.
   */
  private withinSection(below: number, length: number, pivot: THREE.Vector3, along: THREE.Vector3): number {
    const { plane, bodySize_m } = this.stage;
    if (!plane) return below;
    const normal = new THREE.Vector3(plane[0], plane[1], plane[2]);
    const slope = normal.dot(along) || -1e-9;
    // Where the edge's line meets the plane; far away it would only make a long way.
    const at = Math.max(-bodySize_m, Math.min(bodySize_m, (plane[3] - normal.dot(pivot)) / slope));
    if (slope > 0) return Math.min(below, at);
    return this.depth_m === null ? Math.max(below, at + length) : below;
  }

  /**
   * Sends the next pose, slowly enough that the server does not take it for a jump: a flick takes a little longer on
   * the blade's clock. A long step is divided, since the server ends a stroke at a long gap.
   */
  private put(pose: Pose, buttons: number): void {
    const facts = this.facts!;
    const before = this.last;
    const way = before ? Math.max(before.heel.distanceTo(pose.heel), before.tip.distanceTo(pose.tip)) : 0;
    const least_ms = facts.maxSpeed_m_s > 0 ? (1000 * way) / (kSafeSpeed * facts.maxSpeed_m_s) : 0;
    const begin_ms = this.sourceTime_ms;
    const end_ms = Math.max(pose.time_ms, begin_ms + Math.max(0.01, least_ms));
    const steps = before && buttons !== 0 ? Math.max(1, Math.ceil((end_ms - begin_ms) / kLongestStep_ms)) : 1;
    for (let n = 1; n <= steps; ++n) {
      const t = n / steps;
      this.push(
        before ? before.heel.clone().lerp(pose.heel, t) : pose.heel,
        before ? before.tip.clone().lerp(pose.tip, t) : pose.tip,
        steps === 1 ? end_ms : begin_ms + t * (end_ms - begin_ms),
        buttons,
      );
    }
    this.last = pose;
    this.events.moved(pose.heel.toArray(), pose.tip.toArray(), buttons !== 0 || facts.engageButton < 0);
  }

  private push(heel: THREE.Vector3, tip: THREE.Vector3, time_ms: number, buttons: number): void {
    const facts = this.facts!;
    const toolHeel = new THREE.Vector3(...facts.heel);
    const toolDown = new THREE.Vector3(...facts.tip).sub(toolHeel).normalize();
    const turn = new THREE.Quaternion().setFromUnitVectors(toolDown, tip.clone().sub(heel).normalize());
    const at = heel.clone().sub(toolHeel.applyQuaternion(turn));
    this.sourceTime_ms = time_ms;
    this.batch.push(time_ms, at.x, at.y, at.z, turn.w, turn.x, turn.y, turn.z, buttons);
  }

  private flush(): void {
    if (this.batch.length === 0) return;
    this.events.poses(Float64Array.from(this.batch));
    this.batch = [];
    this.lastSent_ms = performance.timeOrigin + performance.now();
  }
}
