/** When revisions were made, and by which stroke: entry i is of revision first + i. */
export interface Revisions {
  ms: number[]; // never falls
  sources: number[];
  strokes: number[]; // 0: a deformation
}

/** One stroke on a timeline. */
export interface Bar {
  source: number;
  stroke: number;
  first: number; // revision
  last: number;
  from_ms: number;
  to_ms: number;
  own: boolean;
  cutArea_m2?: number; // one side; of a live stroke
}

/** The strokes among the revisions from 1 on, in order of their begin. */
export function barsOf({ ms, sources, strokes }: Revisions): Bar[] {
  const bars = new Map<string, Bar>();
  for (let i = 0; i < ms.length; ++i) {
    if (strokes[i] === 0) continue;
    const key = `${sources[i]},${strokes[i]}`;
    const bar = bars.get(key);
    if (bar) {
      bar.last = i + 1;
      bar.to_ms = ms[i];
    } else {
      const [source, stroke, first] = [sources[i], strokes[i], i + 1];
      bars.set(key, { source, stroke, first, last: first, from_ms: ms[i], to_ms: ms[i], own: false });
    }
  }
  return [...bars.values()];
}

/** When a revision was there. */
export function timeOf({ ms }: Revisions, revision: number): number {
  return revision < 1 ? 0 : (ms[Math.min(revision, ms.length) - 1] ?? 0);
}

/** The last revision that was there at this time. */
export function revisionAt({ ms }: Revisions, at_ms: number): number {
  let low = 0,
    high = ms.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (ms[middle] <= at_ms) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Where to go with a key: the begin of the next stroke, or of this one, or of the one before. */
export function strokeFrom(bars: Bar[], revision: number, step: 1 | -1, end: number): number {
  const begins = bars.map((bar) => bar.first - 1).sort((a, b) => a - b);
  if (step > 0) return begins.find((begin) => begin > revision) ?? end;
  return begins.reverse().find((begin) => begin < revision) ?? 0;
}

/** The time between two ticks, a round number of ms of which at most `most` fit. */
export function tickStep(span_ms: number, most: number): number {
  for (let power = 100; ; power *= 10) {
    for (const digit of [1, 2, 5]) if (span_ms <= digit * power * most) return digit * power;
  }
}

export const seconds = (ms: number): string => (ms / 1000).toFixed(1);

const kInset_px = 2; // as wide as half the slider's thumb (style.css)
const kTicks_px = 13; // height of the line with the seconds
const kTick_px = 70;

/** Draws strokes as bars, a row for each blade, over a line with seconds. */
export class Timeline {
  private bars: Bar[] = [];
  chosen: Bar | undefined; // the others are drawn faintly
  private from_ms = 0;
  private to_ms = 1;

  /** host: what the pointer is over. colourOf: of a bar, in CSS; titleOf: what it says of itself. */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    host: HTMLElement,
    private readonly colourOf: (bar: Bar) => string,
    titleOf: (bar: Bar) => string,
    idle: string,
  ) {
    new ResizeObserver(() => this.draw()).observe(canvas);
    host.addEventListener("pointermove", (e) => {
      const bar = this.barAt(e);
      host.title = bar ? titleOf(bar) : idle;
    });
  }

  /** The bar under the pointer, or one at its time in another row. */
  barAt({ clientX, clientY }: MouseEvent): Bar | undefined {
    const { left, top, height } = this.canvas.getBoundingClientRect();
    const at = this.timeAt(clientX - left);
    const margin = (this.to_ms - this.from_ms) / 100;
    const there = this.bars.filter((b) => at >= b.from_ms - margin && at <= b.to_ms + margin);
    const { rows } = this;
    const source = rows[Math.floor(((clientY - top) / (height - kTicks_px)) * rows.length)];
    return there.find((b) => b.source === source) ?? there[0];
  }

  private get rows(): number[] {
    return [...new Set(this.bars.map((bar) => bar.source))].sort((a, b) => a - b);
  }

  show(bars: Bar[], from_ms: number, to_ms: number): void {
    this.bars = bars;
    this.from_ms = from_ms;
    this.to_ms = Math.max(to_ms, from_ms + 1);
    this.draw();
  }

  draw(): void {
    const { canvas, from_ms, to_ms } = this;
    const width = canvas.clientWidth,
      height = canvas.clientHeight;
    if (width === 0) return;
    const ratio = Math.min(2, devicePixelRatio);
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const g = canvas.getContext("2d")!;
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    const style = getComputedStyle(canvas);
    const x = (ms: number) => kInset_px + ((ms - from_ms) / (to_ms - from_ms)) * (width - 2 * kInset_px);
    const floor = height - kTicks_px;
    g.fillStyle = style.getPropertyValue("--line");
    g.fillRect(0, floor, width, 1);
    g.font = "10.5px ui-sans-serif, system-ui, Arial, sans-serif";
    g.textBaseline = "top";
    const step = tickStep(to_ms - from_ms, Math.max(1, Math.floor(width / kTick_px)));
    for (let ms = Math.ceil(from_ms / step) * step; ms <= to_ms; ms += step) {
      g.fillStyle = style.getPropertyValue("--line");
      g.fillRect(Math.round(x(ms)), floor - 3, 1, 4);
      g.fillStyle = style.getPropertyValue("--soft");
      const text = `${Number((ms / 1000).toFixed(1))} s`;
      g.fillText(text, Math.max(0, Math.min(x(ms) - 3, width - g.measureText(text).width)), floor + 2.5);
    }
    const { rows } = this;
    const row = (floor - 3) / Math.max(1, rows.length);
    for (const bar of this.bars) {
      g.fillStyle = this.colourOf(bar);
      g.globalAlpha = this.chosen && bar !== this.chosen ? 0.35 : 1;
      const left = x(bar.from_ms);
      g.beginPath();
      g.roundRect(left, 1 + row * rows.indexOf(bar.source), Math.max(3, x(bar.to_ms) - left), Math.max(2, row - 2), 2);
      g.fill();
    }
  }

  private timeAt(x: number): number {
    const share = (x - kInset_px) / Math.max(1, this.canvas.clientWidth - 2 * kInset_px);
    return this.from_ms + Math.min(1, Math.max(0, share)) * (this.to_ms - this.from_ms);
  }
}
