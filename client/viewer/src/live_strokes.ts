import type { BladeStep } from "./messages";
import { type Bar, Timeline } from "./timeline";

const kMostStrokes = 200;
const kMostPause_ms = 500; // a longer silence is shown as this, like in a replay

/** The strokes of the live session that this page has seen. */
export class LiveStrokes {
  private bars: Bar[] = [];
  private clock_ms = 0;
  private arrived_ms = NaN; // of the last step, on the server's clock
  private waiting = false;
  readonly timeline: Timeline;

  /** changed: the strokes have. */
  constructor(
    canvas: HTMLCanvasElement,
    colourOf: (bar: Bar) => string,
    titleOf: (bar: Bar) => string,
    private readonly changed: () => void,
  ) {
    this.timeline = new Timeline(
      canvas,
      canvas,
      colourOf,
      titleOf,
      "Strokes that this page has seen; long pauses are shortened",
    );
  }

  get strokes(): readonly Bar[] {
    return this.bars;
  }

  add(step: BladeStep): void {
    const pause = Number.isNaN(this.arrived_ms) ? 0 : step.arrived_ms - this.arrived_ms;
    this.clock_ms += Math.min(kMostPause_ms, Math.max(0, pause));
    this.arrived_ms = Math.max(step.arrived_ms, Number.isNaN(this.arrived_ms) ? -Infinity : this.arrived_ms);
    const { source, stroke, revision, own } = step;
    let bar = this.bars.find((b) => b.source === source && b.stroke === stroke);
    if (!bar) {
      const at = { from_ms: this.clock_ms, to_ms: this.clock_ms };
      bar = { source, stroke, own, first: revision, last: revision, cutArea_m2: 0, ...at };
      this.bars.push(bar);
      if (this.bars.length > kMostStrokes) this.bars.shift();
    }
    bar.last = revision;
    bar.to_ms = this.clock_ms;
    bar.cutArea_m2! += step.cutArea_m2;
    this.showSoon();
  }

  /** The body is at this revision of another run: what came after it is undone. */
  restart(revision: number): void {
    this.bars = this.bars.filter((bar) => bar.last <= revision);
    this.arrived_ms = NaN;
    this.clock_ms =
      this.bars.reduce((end, bar) => Math.max(end, bar.to_ms), 0) + (this.bars.length > 0 ? kMostPause_ms : 0);
    this.showSoon();
  }

  /** At most once a frame. */
  private showSoon(): void {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.changed();
      this.timeline.show(this.bars, this.bars[0]?.from_ms ?? 0, this.clock_ms);
    });
  }
}
