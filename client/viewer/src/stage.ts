import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { BladeView } from "./blade_view";
import { BodyMesh } from "./body_mesh";
import { Marks } from "./marks";
import type { Vec3 } from "./messages";
import { Resolution } from "./resolution";
import { type Hit, pick } from "./pick";
import { planeOf, type Section } from "./section";
import { SectionLines } from "./section_lines";
import { Flight, fromSpherical, toSpherical } from "./views";

const kBeforeBody = 0.6; // times the body's size, from its middle
const kSettle_ms = 220; // after the last motion the picture is drawn again at full resolution
const kFine_ms = 900; // and then above it, where the renderer does not smooth edges

/** Whether the browser draws on the processor. */
function drawnInSoftware(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = info ? String(gl!.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

/** quick: as many pixels as the machine can draw in time; full: as many as the screen has; fine: more. */
type Quality = "quick" | "full" | "fine";
export type Tool = "cut" | "turn" | "measure";

/** The picture: camera, lights, body, blades. Draws only when something has changed. */
export class Stage {
  readonly renderer: THREE.WebGLRenderer;
  readonly camera = new THREE.PerspectiveCamera(32, 1, 0.01, 100);
  readonly controls: OrbitControls;
  readonly body = new BodyMesh();
  readonly marks: Marks;
  readonly centre = new THREE.Vector3();
  private readonly halfSize = new THREE.Vector3(); // of the body's box
  bodySize_m = 0.3;
  /** Called before each frame; true: something moves, draw again. */
  beforeDraw: (now_ms: number) => boolean = () => false;
  /** Called after each frame is drawn. */
  afterDraw: () => void = () => {};
  /** Called when nothing moves any more. */
  onRest: () => void = () => {};
  framesDrawn = 0;
  readonly software: boolean;

  private readonly scene = new THREE.Scene();
  private readonly backdrop: THREE.Mesh<THREE.PlaneGeometry, THREE.ShaderMaterial>;
  private readonly ground: THREE.Mesh<THREE.PlaneGeometry, THREE.ShaderMaterial>;
  private blades = new Map<number, BladeView>();
  private wanted = true;
  private waiting = false; // for the browser's next frame
  private readonly resolution: Resolution;
  private quality: Quality = "full";
  private paced = false; // the last frame was part of a motion
  private lastFrame_ms = 0;
  private lastDraw_ms = 0;
  private alarm: ReturnType<typeof setTimeout> | undefined; // when a resting blade vanishes
  openNow = 0;
  private openGoal = 0;
  private heldGoal = 0;
  private section: Section | null = null;
  plane: readonly number[] | null = null; // of the section: normal, offset
  private readonly sectionLines = new SectionLines();
  private linesShown = ""; // what the lines were made of
  private flight: Flight | null = null;
  readonly calm = matchMedia("(prefers-reduced-motion: reduce)");

  constructor(
    private readonly canvas: HTMLCanvasElement,
    marks: HTMLCanvasElement,
  ) {
    this.marks = new Marks(marks, this.camera);
    // Without a graphics card: fewer pixels, no blur behind panels.
    this.software = drawnInSoftware();
    document.body.classList.toggle("software", this.software);
    this.resolution = new Resolution(this.software);
    // Opaque, with a backdrop of its own: the browser need not blend the whole window each frame.
    this.renderer = new THREE.WebGLRenderer({
      canvas,
      antialias: !this.software,
      alpha: false,
      powerPreference: "high-performance",
    });
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = !this.calm.matches;
    this.controls.dampingFactor = 0.12;
    this.controls.zoomToCursor = true;
    this.controls.addEventListener("change", () => this.draw());
    this.controls.addEventListener("start", () => (this.flight = null));
    // A coarse grid: interpolating colours is cheaper than computing them for each pixel.
    this.backdrop = new THREE.Mesh(
      new THREE.PlaneGeometry(2, 2, 24, 16),
      new THREE.ShaderMaterial({
        transparent: true,
        blending: THREE.NoBlending,
        depthWrite: false, // drawn after the body, where that is not
        uniforms: { uInner: { value: new THREE.Color() }, uOuter: { value: new THREE.Color() } },
        vertexShader: `uniform vec3 uInner; uniform vec3 uOuter; varying vec3 vColour;
        void main() {
          float r = length((0.5 * position.xy + 0.5 - vec2(0.46, 0.60)) / vec2(1.2, 0.95));
          vColour = mix(uInner, uOuter, min(r, 1.0));
          gl_Position = vec4(position.xy, 1.0, 1.0);
        }`,
        fragmentShader: `varying vec3 vColour;
        void main() {
          float grit = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715)))); // hides bands (Jimenez 2014)
          gl_FragColor = vec4(vColour + (grit - 0.5) / 255.0, 1.0);
        }`,
      }),
    );
    this.backdrop.frustumCulled = false;
    this.backdrop.renderOrder = -2;
    this.ground = new THREE.Mesh(
      new THREE.PlaneGeometry(1, 1),
      new THREE.ShaderMaterial({
        transparent: true,
        depthWrite: false,
        uniforms: {
          uInk: { value: new THREE.Color(0xffffff) },
          uShade: { value: 0.5 },
          uSize: { value: 1 },
          uLine: { value: 1 },
        },
        vertexShader: `varying vec2 vAt; uniform float uSize; void main() { vAt = position.xy * uSize; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`,
        fragmentShader: `varying vec2 vAt; uniform vec3 uInk; uniform float uShade; uniform float uSize; uniform float uLine; // its width in pixels
        float lines(float cell) { vec2 g = abs(fract(vAt / cell - 0.5) - 0.5) / (uLine * fwidth(vAt / cell)); return 1.0 - clamp(min(g.x, g.y), 0.0, 1.0); }
        void main() {
          float r = length(vAt) / uSize * 2.0;
          float fade = 1.0 - smoothstep(0.35, 1.0, r);
          float grid = max(0.10 * lines(0.01), 0.22 * lines(0.05)) * fade;
          float shadow = uShade * exp(-r * r * 22.0);
          gl_FragColor = vec4(mix(uInk, vec3(0.0), shadow / (shadow + grid + 1e-4)), max(grid, shadow));
        }`,
      }),
    );
    this.ground.renderOrder = -1;
    this.scene.add(this.backdrop, this.ground, this.body.mesh, this.sectionLines.group);
    this.setTool("turn");
    canvas.addEventListener("webglcontextrestored", () => this.draw());
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.resize();
  }

  draw(): void {
    this.wanted = true;
    this.awaitFrame();
  }

  /** Nothing will be drawn until something changes. */
  get atRest(): boolean {
    return this.framesDrawn > 0 && !this.waiting;
  }

  /** Labels the blades of others. */
  labelBlades(marks: Marks, nameOf: (source: number) => string): void {
    for (const blade of this.blades.values()) blade.label(marks, nameOf(blade.source));
  }

  get bladesShown(): number {
    return [...this.blades.values()].filter((blade) => blade.shown).length;
  }

  private awaitFrame(): void {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame((now) => {
      this.waiting = false;
      this.frame(now);
    });
  }

  setBody(min: Vec3, max: Vec3): void {
    this.centre.set((min[0] + max[0]) / 2, (min[1] + max[1]) / 2, (min[2] + max[2]) / 2);
    this.halfSize.set((max[0] - min[0]) / 2, (max[1] - min[1]) / 2, (max[2] - min[2]) / 2);
    this.bodySize_m = Math.hypot(max[0] - min[0], max[1] - min[1], max[2] - min[2]) || 1;
    this.min = min;
    this.max = max;
    this.body.uniforms.uGrain.value = 55 / this.bodySize_m;
    const size = 2.6 * this.bodySize_m;
    this.ground.scale.set(size, size, 1);
    this.ground.material.uniforms.uSize.value = size;
    this.ground.position.set(this.centre.x, this.centre.y, min[2] - 0.02 * this.bodySize_m);
    this.camera.near = 0.02 * this.bodySize_m;
    this.camera.far = 30 * this.bodySize_m;
    this.controls.minDistance = 0.15 * this.bodySize_m;
    this.controls.maxDistance = 8 * this.bodySize_m;
    for (const blade of this.blades.values()) {
      this.scene.remove(blade.group);
      blade.dispose();
    }
    this.blades.clear();
    this.applySection();
  }
  min: Vec3 = [0, 0, 0]; // the body's box
  max: Vec3 = [0, 0, 0];

  blade(source: number, own: boolean): BladeView {
    const key = own ? -1 : source;
    let view = this.blades.get(key);
    if (!view) {
      view = new BladeView(this.bodySize_m, source, own);
      this.blades.set(key, view);
      this.scene.add(view.group);
    }
    return view;
  }

  /** The whole body in view, from the front and a little above. */
  fit(at_once = false, direction = new THREE.Vector3(-0.18, -0.62, 0.76)): void {
    const { left, right, top, bottom } = this.cover;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    // The share of the picture's height that the body may fill.
    const free = Math.max(0.2, Math.min(height - top - bottom, 0.8 * (width - left - right)) / (height || 1));
    const half = Math.tan((this.camera.fov * Math.PI) / 360) * free;
    const distance = Math.max((0.4 * this.bodySize_m) / half, this.wholeFrom(direction.normalize(), half));
    this.fittedFrom_m = distance;
    const to = direction.multiplyScalar(distance).add(this.centre);
    if (at_once || this.calm.matches) return this.placeCamera(to, this.centre);
    const { target } = this.controls;
    const from = { position: this.camera.position, target };
    this.flight = new Flight(from, { position: to, target: this.centre }, performance.now());
    this.draw();
  }

  /** The window's size has changed: a body that was fitted into the picture, and at most turned since, is fitted again. */
  refit(): void {
    const { target } = this.controls;
    const arm = this.camera.position.clone().sub(target);
    const near_m = 1e-3 * this.fittedFrom_m;
    if (Math.abs(arm.length() - this.fittedFrom_m) < near_m && target.distanceTo(this.centre) < near_m)
      this.fit(true, arm);
  }
  private fittedFrom_m = 0; // the camera's distance from the body's centre

  /** From how far away in this direction all of the body's box is seen. half: tangent of half the angle that it may fill upwards. */
  private wholeFrom(direction: THREE.Vector3, half: number): number {
    const right = new THREE.Vector3().crossVectors(this.camera.up, direction).normalize();
    const up = new THREE.Vector3().crossVectors(direction, right);
    const corner = new THREE.Vector3();
    let distance = 0;
    for (let k = 0; k < 8; ++k) {
      const sign = (bit: number) => ((k >> bit) & 1) * 2 - 1;
      corner.set(sign(0) * this.halfSize.x, sign(1) * this.halfSize.y, sign(2) * this.halfSize.z);
      distance = Math.max(distance, Math.abs(corner.dot(up)) / half + corner.dot(direction));
    }
    return distance;
  }

  /** Puts the camera there at once. */
  placeCamera(position: THREE.Vector3, target: THREE.Vector3): void {
    this.flight = null;
    this.camera.position.copy(position);
    this.controls.target.copy(target);
    this.controls.update();
    this.draw();
  }

  /** The whole body in view, from this direction. */
  lookFrom(direction: Vec3): void {
    this.fit(false, new THREE.Vector3(...direction));
  }

  /** Turns around the body, in steps of 6 degrees. */
  turn(right: number, up: number): void {
    const step = Math.PI / 30;
    const arm = this.camera.position.clone().sub(this.controls.target);
    const at = toSpherical(arm);
    at.theta += right * step;
    at.phi = Math.min(Math.PI - 0.05, Math.max(0.05, at.phi - up * step));
    this.camera.position.copy(fromSpherical(at)).add(this.controls.target);
    this.controls.update();
    this.draw();
  }

  zoom(factor: number): void {
    this.camera.position.sub(this.controls.target).multiplyScalar(factor).add(this.controls.target);
    this.controls.update();
    this.draw();
  }

  setTool(tool: Tool): void {
    const { MOUSE, TOUCH } = THREE;
    const cut = tool === "cut";
    this.controls.mouseButtons = cut
      ? { LEFT: null as never, MIDDLE: MOUSE.PAN, RIGHT: MOUSE.ROTATE }
      : { LEFT: MOUSE.ROTATE, MIDDLE: MOUSE.PAN, RIGHT: MOUSE.PAN };
    this.controls.touches = cut
      ? { ONE: null as never, TWO: TOUCH.DOLLY_ROTATE }
      : { ONE: TOUCH.ROTATE, TWO: TOUCH.DOLLY_PAN };
  }

  setOpen(share: number, at_once = false): void {
    this.openGoal = share;
    if (at_once || this.calm.matches) this.openNow = share;
    this.draw();
  }

  /** Nothing is opened along the ray, from here on or until the next one: what is drawn there is where it is. */
  hold(ray: THREE.Ray): void {
    this.heldGoal = 1;
    this.body.hold(ray, this.bodySize_m);
    this.draw();
  }

  /** Where a blade whose heel may be at the eye comes near the body: the place on it that is drawn as its heel. */
  beforeBody(heel: Vec3, tip: Vec3): Vec3 {
    const from = new THREE.Vector3(...tip);
    const back = new THREE.Vector3(...heel).sub(from);
    const length = back.length();
    back.normalize();
    const way = this.centre.clone().sub(from).dot(back) + kBeforeBody * this.bodySize_m;
    return from.addScaledVector(back, Math.min(length, Math.max(way, 0))).toArray();
  }

  /** Everything opens as it would without hold(). */
  release(): void {
    this.heldGoal = 0;
    if (this.calm.matches) this.body.held = 0;
    this.draw();
  }

  setSection(section: Section | null): void {
    this.section = section;
    this.applySection();
    this.draw();
  }

  /** The vector from what the camera looks at to the camera. */
  get toEye(): Vec3 {
    return this.camera.position.clone().sub(this.controls.target).toArray();
  }

  /** What is seen at (x, y), normalised device coordinates. */
  pick(x: number, y: number): Hit | null {
    const ray = new THREE.Raycaster();
    this.camera.updateMatrixWorld(); // it may have moved since the last frame
    ray.setFromCamera(new THREE.Vector2(x, y), this.camera);
    return pick(this.body, this.openNow, this.plane, ray.ray);
  }

  /** What a link keeps of the camera; z is always up. */
  get cameraPlace(): { position: Vec3; target: Vec3 } {
    return { position: this.camera.position.toArray(), target: this.controls.target.toArray() };
  }

  /** backdrop: its colours in the middle and at the edge, as #rrggbb. */
  setInk(ink: THREE.ColorRepresentation, shade: number, ambient: number, backdrop: [string, string]): void {
    // Not converted: the shader mixes them as they are.
    this.backdrop.material.uniforms.uInner.value.setStyle(backdrop[0], THREE.LinearSRGBColorSpace);
    this.backdrop.material.uniforms.uOuter.value.setStyle(backdrop[1], THREE.LinearSRGBColorSpace);
    this.ground.material.uniforms.uInk.value.set(ink);
    this.ground.material.uniforms.uShade.value = shade;
    this.body.uniforms.uAmbient.value = ambient;
    this.draw();
  }

  /** What is seen with the marks over it, with at least as many pixels as the screen has. */
  picture(): Promise<Blob> {
    this.setQuality(this.best);
    this.render();
    // Now: WebGL does not keep a frame.
    const sheet = document.createElement("canvas");
    sheet.width = this.canvas.width;
    sheet.height = this.canvas.height;
    const pen = sheet.getContext("2d")!;
    pen.drawImage(this.canvas, 0, 0);
    this.marks.drawOn(pen, sheet.width / this.canvas.clientWidth);
    return new Promise((resolve, reject) =>
      sheet.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("no memory for the picture"))), "image/png"),
    );
  }

  /** Sets how many pixels at each side are covered by panels. */
  setCover(cover: { left: number; right: number; top: number; bottom: number }): void {
    this.cover = cover;
    this.resize();
  }
  cover = { left: 0, right: 0, top: 0, bottom: 0 };

  /** Red, green, blue, opacity (0 to 255) at (x, y), 0 to 1. Draws first: WebGL does not keep a frame. */
  colourAt(x: number, y: number): number[] {
    this.renderer.render(this.scene, this.camera);
    const gl = this.renderer.getContext();
    const pixel = new Uint8Array(4);
    gl.readPixels(
      Math.floor(x * gl.drawingBufferWidth),
      Math.floor((1 - y) * gl.drawingBufferHeight),
      1,
      1,
      gl.RGBA,
      gl.UNSIGNED_BYTE,
      pixel,
    );
    return Array.from(pixel);
  }

  private applySection(): void {
    this.plane = this.section && planeOf(this.section, this.min, this.max);
    this.body.setSection(this.plane);
  }

  private followSection(): void {
    const held = this.body.held > 0 ? this.body.heldLine : [];
    const from = this.plane ? [this.body.version, this.openNow, ...this.plane, ...held].join() : "";
    if (from === this.linesShown) return;
    this.linesShown = from;
    this.sectionLines.show(this.plane && this.body.shown(this.openNow), this.plane ?? [], this.bodySize_m);
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width === 0 || height === 0) return;
    this.camera.aspect = width / height;
    // The centre of the picture is that of the part without panels.
    const { left, right, top, bottom } = this.cover;
    this.camera.setViewOffset(width, height, (right - left) / 2, (bottom - top) / 2, width, height);
    this.camera.updateProjectionMatrix();
    this.applyScale();
    this.draw();
  }

  private applyScale(): void {
    const full = Math.min(devicePixelRatio, 2);
    this.renderer.setPixelRatio(
      this.quality === "quick" ? full * this.resolution.scale : this.quality === "full" ? full : 2,
    );
    this.renderer.setSize(this.canvas.clientWidth, this.canvas.clientHeight, false);
  }

  private get best(): Quality {
    return this.software ? "fine" : "full";
  }

  private setQuality(quality: Quality): void {
    if (this.quality === quality) return;
    this.quality = quality;
    this.applyScale();
  }

  private frame(now_ms: number): void {
    if (this.paced && this.resolution.took(now_ms - this.lastFrame_ms) && this.quality === "quick") this.applyScale();
    this.paced = false;
    this.lastFrame_ms = now_ms;
    const rested_ms = now_ms - this.lastDraw_ms;
    const { best } = this;
    if (this.advance(now_ms) || this.wanted) {
      this.wanted = false;
      this.lastDraw_ms = now_ms;
      this.paced = rested_ms < kSettle_ms; // a single change is not a motion
      this.setQuality(this.paced && this.resolution.scale < 1 ? "quick" : "full");
      this.render();
    } else if (this.quality === "quick" ? rested_ms > kSettle_ms : this.quality !== best && rested_ms > kFine_ms) {
      this.setQuality(this.quality === "quick" ? "full" : "fine");
      this.render();
    }
    if (this.lastDraw_ms === now_ms || this.quality !== best) this.awaitFrame();
    else this.onRest();
  }

  /** Advances everything that moves by itself. True: the picture has changed. */
  private advance(now_ms: number): boolean {
    let moves = this.fly(now_ms);
    if (this.controls.enabled) this.controls.update();
    const eased = (now: number, goal: number) => {
      if (now !== goal) moves = true;
      const step = 0.22 * (goal - now);
      return Math.abs(step) < 0.002 ? goal : now + step;
    };
    this.openNow = eased(this.openNow, this.openGoal);
    this.body.held = eased(this.body.held, this.heldGoal);
    let next_ms = Infinity;
    for (const blade of this.blades.values()) next_ms = Math.min(next_ms, blade.update(this.camera.position));
    clearTimeout(this.alarm);
    if (next_ms > 0 && next_ms < Infinity) this.alarm = setTimeout(() => this.draw(), next_ms);
    if (next_ms === 0) moves = true;
    return this.beforeDraw(now_ms) || moves;
  }

  private render(): void {
    const u = this.body.uniforms;
    this.ground.material.uniforms.uLine.value = Math.max(1, this.renderer.getPixelRatio());
    u.uOpen.value = this.openNow;
    this.followSection();
    // The back of a closed surface is seen in a section, and in folds of lifted lips, which are not worth the time
    // without a graphics card.
    this.body.setEffort(!this.software || this.section !== null, !this.software || this.quality !== "quick");
    // The key light hangs over the viewer's left shoulder, so that what one looks at is lit.
    const right = new THREE.Vector3().setFromMatrixColumn(this.camera.matrixWorld, 0);
    const up = new THREE.Vector3().setFromMatrixColumn(this.camera.matrixWorld, 1);
    const back = new THREE.Vector3().setFromMatrixColumn(this.camera.matrixWorld, 2);
    u.uLight.value.copy(back).addScaledVector(up, 0.9).addScaledVector(right, -0.55).normalize();
    u.uFill.value.copy(back).multiplyScalar(0.4).addScaledVector(right, 1).addScaledVector(up, -0.1).normalize();
    if (this.plane) this.sectionLines.light(this.plane, u.uLight.value);
    this.renderer.render(this.scene, this.camera);
    this.marks.draw();
    ++this.framesDrawn;
    this.afterDraw();
  }

  private fly(now_ms: number): boolean {
    if (!this.flight) return false;
    const camera = { position: this.camera.position, target: this.controls.target };
    if (this.flight.move(now_ms, camera)) this.flight = null;
    return true;
  }
}
