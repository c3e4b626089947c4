import type * as THREE from "three";

const kFont = '600 13px ui-sans-serif, system-ui, "Segoe UI", Arial, sans-serif';
const kPad_px = 7;
const kHeight_px = 22;
const kLabelStep_px = kHeight_px + 3;
const kMostLabelSteps = 6;

/** Lines, dots and labels over the picture, in the colours of the page. Drawn without drawing the body again. */
export class Marks {
  /** What draws, each time the camera or the body has moved. */
  readonly layers: ((marks: Marks) => void)[] = [];
  /** The same of what only helps the hand, and is no part of a saved picture. */
  readonly tools: ((marks: Marks) => void)[] = [];
  private pen: CanvasRenderingContext2D;
  private colours = { accent: "", ground: "", ink: "" };
  private used = false;
  private labels: { x: number; y: number; width: number; height: number }[] = []; // of this drawing
  /** What lies over the picture, where a label would not be read. */
  covered: () => readonly DOMRect[] = () => [];

  constructor(
    readonly canvas: HTMLCanvasElement,
    private readonly camera: THREE.Camera,
  ) {
    this.pen = canvas.getContext("2d")!;
  }

  draw(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const scale = Math.min(devicePixelRatio, 2);
    // Setting the size clears it.
    if (this.used || this.canvas.width !== width * scale || this.canvas.height !== height * scale) {
      this.canvas.width = width * scale;
      this.canvas.height = height * scale;
    }
    this.used = false;
    this.labels = this.covered().map(({ x, y, width, height }) => ({ x, y, width, height }));
    this.pen.setTransform(scale, 0, 0, scale, 0, 0);
    for (const layer of [...this.layers, ...this.tools]) layer(this);
    // Chromium 156 without a graphics card goes on showing a canvas that was cleared and got nothing new.
    this.canvas.style.visibility = this.used ? "" : "hidden";
  }

  /** Draws on another sheet, which has `scale` pixels for one of the page. A copy of the canvas would not do: just after it was cleared, Chromium copies what was there before. */
  drawOn(sheet: CanvasRenderingContext2D, scale: number): void {
    const { pen, used } = this;
    this.pen = sheet;
    this.labels = [];
    sheet.setTransform(scale, 0, 0, scale, 0, 0);
    for (const layer of this.layers) layer(this);
    sheet.resetTransform();
    this.pen = pen;
    this.used = used;
  }

  line(from: THREE.Vector3, to: THREE.Vector3, width = 2): void {
    this.path([from, to], width);
  }

  /** A line through these places; none, unless all of them are in front of the camera. */
  path(places: THREE.Vector3[], width: number): void {
    const at: [number, number][] = [];
    for (const place of places) {
      const seen = this.onScreen(place);
      if (!seen) return;
      at.push(seen);
    }
    for (const [colour, more] of [
      [this.begin().ground, 2],
      [this.colours.accent, 0],
    ] as const) {
      this.pen.beginPath();
      for (const p of at) this.pen.lineTo(...p);
      this.pen.lineCap = this.pen.lineJoin = "round";
      this.pen.lineWidth = width + more;
      this.pen.strokeStyle = colour;
      this.pen.stroke();
    }
  }

  /** A line with a head of this length, in metres. */
  arrow(from: THREE.Vector3, to: THREE.Vector3, head_m: number): void {
    const a = this.onScreen(from),
      b = this.onScreen(to);
    const neck = this.onScreen(to.clone().add(from.clone().sub(to).setLength(head_m)));
    if (!a || !b || !neck) return;
    this.line(from, to, 4);
    // Seen from the front it has no direction.
    const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
    if (length < 4) return this.dot(to, 6, false);
    const head = Math.max(9, Math.hypot(b[0] - neck[0], b[1] - neck[1]));
    const x = ((b[0] - a[0]) / length) * head,
      y = ((b[1] - a[1]) / length) * head;
    const { accent, ground } = this.begin();
    this.pen.beginPath();
    this.pen.moveTo(b[0] + 0.6 * x, b[1] + 0.6 * y);
    this.pen.lineTo(b[0] - 0.4 * x - 0.5 * y, b[1] - 0.4 * y + 0.5 * x);
    this.pen.lineTo(b[0] - 0.4 * x + 0.5 * y, b[1] - 0.4 * y - 0.5 * x);
    this.pen.closePath();
    this.pen.lineWidth = 2;
    this.pen.strokeStyle = ground;
    this.pen.stroke();
    this.pen.fillStyle = accent;
    this.pen.fill();
  }

  dot(at: THREE.Vector3, radius = 4, filled = true): void {
    const place = this.onScreen(at);
    if (!place) return;
    const { accent, ground } = this.begin();
    this.pen.beginPath();
    this.pen.arc(...place, radius, 0, 2 * Math.PI);
    this.pen.lineWidth = filled ? 1.5 : 2;
    this.pen.fillStyle = accent;
    this.pen.strokeStyle = filled ? ground : accent;
    if (filled) this.pen.fill();
    this.pen.stroke();
  }

  /** A label beside this place, inside the picture, above or below the labels that are there. border: in CSS, else the accent's. */
  label(at: THREE.Vector3, text: string, border?: string): void {
    const place = this.onScreen(at);
    if (!place) return;
    const { ground, ink, accent } = this.begin();
    this.pen.font = kFont;
    const width = this.pen.measureText(text).width + 2 * kPad_px;
    const x = Math.max(4, Math.min(place[0] + 12, this.canvas.clientWidth - width - 4));
    const y = this.freeHeight(x, place[1] - kHeight_px - 8, width);
    this.labels.push({ x, y, width, height: kHeight_px });
    this.pen.beginPath();
    this.pen.roundRect(x, y, width, kHeight_px, 6);
    this.pen.fillStyle = ground;
    this.pen.fill();
    this.pen.lineWidth = 1;
    this.pen.strokeStyle = border ?? accent;
    this.pen.stroke();
    this.pen.fillStyle = ink;
    this.pen.textBaseline = "middle";
    this.pen.fillText(text, x + kPad_px, y + kHeight_px / 2 + 0.5);
  }

  /** The height nearest to `y` where a label covers no other and nothing covers it; that of `y` where all are taken. */
  private freeHeight(x: number, y: number, width: number): number {
    const inside = (at: number) => Math.max(4, Math.min(at, this.canvas.clientHeight - kHeight_px - 4));
    const free = (at: number) =>
      this.labels.every(
        (l) => at >= l.y + l.height || l.y >= at + kHeight_px || x >= l.x + l.width || l.x >= x + width,
      );
    for (let step = 0; step <= kMostLabelSteps; ++step) {
      for (const at of [inside(y - step * kLabelStep_px), inside(y + step * kLabelStep_px)]) if (free(at)) return at;
    }
    return inside(y);
  }

  private begin(): { accent: string; ground: string; ink: string } {
    if (!this.used) {
      const style = getComputedStyle(document.documentElement);
      const colour = (name: string) => style.getPropertyValue(name).trim();
      this.colours = { accent: colour("--accent"), ground: colour("--solid"), ink: colour("--ink") };
    }
    this.used = true;
    return this.colours;
  }

  /** In pixels of the page; null: it is not in front of the camera. */
  onScreen(at: THREE.Vector3): [number, number] | null {
    const { x, y, z } = at.clone().project(this.camera);
    if (Math.abs(z) > 1) return null;
    return [((x + 1) / 2) * this.canvas.clientWidth, ((1 - y) / 2) * this.canvas.clientHeight];
  }
}
