import * as THREE from "three";
import { colourOf, cssColour } from "./blade_colours";
import type { Marks } from "./marks";
import type { Vec3 } from "./messages";

const kTrailSamples = 256;
const kShown_ms = 2500; // after its last pose
const kTrailTime_ms = 1600;
const kLineFade_ms = 500; // of the mouse's stroke, after its end
const kThick = 0.006, // times the body's size
  kThickest = 0.6; // the same for the distance from the eye
const kLineStep = 0.01,
  kLineWidth = 0.0034; // of that line, times the body's size

/**
 * One blade's edge and the surface it swept a moment ago. The mouse's blade points
 * away from the viewer, who would not see that surface: its stroke is drawn as a line for as long as it lasts.
 */
export class BladeView {
  readonly group = new THREE.Group();
  private readonly edge: THREE.Mesh;
  private readonly grip: THREE.Mesh;
  private readonly trail: THREE.Mesh<THREE.BufferGeometry, THREE.ShaderMaterial>;
  private readonly points = new Float32Array(kTrailSamples * 6); // heel, tip
  private readonly times = new Float64Array(kTrailSamples).fill(-1e12);
  private readonly breaks = new Uint8Array(kTrailSamples); // no surface between this sample and the one before
  private count = 0;
  private seen_ms = -1e12;
  private readonly heel = new THREE.Vector3();
  private readonly tip = new THREE.Vector3();
  private begins = true;
  private ended_ms = Infinity; // the mouse's stroke
  private readonly lineEnd = new THREE.Vector3();

  constructor(
    private readonly bodySize_m: number,
    readonly source: number,
    private readonly own: boolean,
  ) {
    const colour = colourOf(source, own);
    const steel = new THREE.MeshBasicMaterial({ color: colour });
    this.edge = new THREE.Mesh(new THREE.CylinderGeometry(1, 0.25, 1, 10).translate(0, -0.5, 0), steel);
    this.grip = new THREE.Mesh(
      new THREE.CapsuleGeometry(1, 4, 6, 12).translate(0, 3, 0),
      new THREE.MeshBasicMaterial({ color: colour }),
    );
    const geometry = new THREE.BufferGeometry();
    const n = kTrailSamples * 6;
    geometry.setAttribute(
      "position",
      new THREE.BufferAttribute(new Float32Array(3 * n), 3).setUsage(THREE.DynamicDrawUsage),
    );
    geometry.setAttribute("aAge", new THREE.BufferAttribute(new Float32Array(n), 1).setUsage(THREE.DynamicDrawUsage));
    this.trail = new THREE.Mesh(
      geometry,
      new THREE.ShaderMaterial({
        transparent: true,
        depthWrite: false,
        side: THREE.DoubleSide,
        depthTest: !own,
        uniforms: {
          uColour: { value: new THREE.Color().setHex(colour, THREE.LinearSRGBColorSpace) },
          uStrength: { value: own ? 0.9 : 0.42 },
        },
        vertexShader: `attribute float aAge; varying float vAge; void main() { vAge = aAge; gl_Position = projectionMatrix * viewMatrix * vec4(position, 1.0); }`,
        fragmentShader: `uniform vec3 uColour; uniform float uStrength; varying float vAge; void main() { gl_FragColor = vec4(uColour, uStrength * (1.0 - vAge) * (1.0 - vAge)); }`,
      }),
    );
    this.trail.frustumCulled = false;
    this.group.add(this.edge, this.grip, this.trail);
  }

  /** The edge is at heel and tip now; while it cuts it leaves a trail. */
  move(heel: Vec3, tip: Vec3, cuts: boolean): void {
    const now = performance.now();
    this.heel.set(...heel);
    this.tip.set(...tip);
    this.seen_ms = now;
    if (cuts && this.own) {
      this.drawLine(now);
    } else if (cuts) {
      const i = this.count++ % kTrailSamples;
      this.points.set([...heel, ...tip], 6 * i);
      this.times[i] = now;
      this.breaks[i] = this.begins ? 1 : 0;
    }
    this.begins = !cuts;
    this.place();
  }

  /** Extends the line of the mouse's stroke to where the blade is now. */
  private drawLine(now: number): void {
    if (this.begins) {
      this.count = 0;
      this.ended_ms = Infinity;
      this.lineEnd.copy(this.heel);
    }
    const way = this.heel.clone().sub(this.lineEnd);
    if (way.length() < kLineStep * this.bodySize_m) return;
    const side = this.tip
      .clone()
      .sub(this.heel)
      .cross(way)
      .setLength(0.5 * kLineWidth * this.bodySize_m);
    for (const at of this.count === 0 ? [this.lineEnd, this.heel] : [this.heel]) {
      const i = this.count++ % kTrailSamples;
      this.points.set([...at.clone().add(side).toArray(), ...at.clone().sub(side).toArray()], 6 * i);
      this.times[i] = now;
      this.breaks[i] = 0;
    }
    this.lineEnd.copy(this.heel);
  }

  endStroke(): void {
    this.begins = true;
    this.ended_ms = performance.now();
  }

  /** Says whose blade it is, beside its grip. */
  label(marks: Marks, name: string): void {
    if (this.shown && !this.own) marks.label(this.heel, name, cssColour(this.source, false));
  }

  get shown(): boolean {
    return this.edge.visible;
  }

  hide(): void {
    this.seen_ms = -1e12;
  }

  private place(): void {
    const down = new THREE.Vector3().subVectors(this.tip, this.heel);
    const length = down.length();
    this.edge.position.copy(this.heel);
    this.edge.quaternion.setFromUnitVectors(new THREE.Vector3(0, -1, 0), down.normalize());
    this.edge.scale.y = length;
    this.grip.position.copy(this.heel);
    this.grip.quaternion.copy(this.edge.quaternion);
  }

  /** A long blade that points away from the eye has its heel before it: thinner there, it hides nothing. */
  private thin(eye: THREE.Vector3): void {
    const thick = kThick * Math.min(this.bodySize_m, kThickest * eye.distanceTo(this.heel));
    this.edge.scale.x = this.edge.scale.z = 0.5 * thick;
    this.grip.scale.setScalar(thick * (this.own ? 0.5 : 1.6));
  }

  /**
   * Fades the trail, and fits the blade to where it is seen from. Returns after how many ms to draw again: 0 in the next frame,
   * Infinity never.
   */
  update(eye: THREE.Vector3): number {
    const now = performance.now();
    this.thin(eye);
    const idle = now - this.seen_ms;
    this.edge.visible = this.grip.visible = idle < kShown_ms;
    const position = this.trail.geometry.getAttribute("position") as THREE.BufferAttribute;
    const age = this.trail.geometry.getAttribute("aAge") as THREE.BufferAttribute;
    let at = 0;
    const put = (sample: number, tip: number, a: number) => {
      const from = 6 * sample + 3 * tip;
      position.setXYZ(at, this.points[from], this.points[from + 1], this.points[from + 2]);
      age.setX(at++, a);
    };
    const first = Math.max(0, this.count - kTrailSamples) + 1;
    for (let k = Math.max(1, first); k < this.count; ++k) {
      const i = k % kTrailSamples,
        before = (k - 1) % kTrailSamples;
      const age = (sample: number) =>
        this.own ? Math.max(0, now - this.ended_ms) / kLineFade_ms : (now - this.times[sample]) / kTrailTime_ms;
      const a0 = age(before),
        a1 = age(i);
      if (this.breaks[i] || a0 >= 1) continue;
      put(before, 0, a0);
      put(before, 1, a0);
      put(i, 0, a1);
      put(i, 0, a1);
      put(before, 1, a0);
      put(i, 1, a1);
    }
    this.trail.geometry.setDrawRange(0, at);
    if (at > 0) position.needsUpdate = age.needsUpdate = true;
    return at > 0 ? 0 : idle < kShown_ms ? kShown_ms - idle + 1 : Infinity;
  }

  dispose(): void {
    for (const mesh of [this.edge, this.grip, this.trail]) {
      mesh.geometry.dispose();
      (mesh.material as THREE.Material).dispose();
    }
  }
}
