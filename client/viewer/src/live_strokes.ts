import { type BladeNames, cssColour } from "./blade_colours";
import { element, number } from "./dom";
import type { BladeStep } from "./messages";
import { type Bar, seconds, Timeline } from "./timeline";

const kMostStrokes = 200;
const kMostPause_ms = 500; // a longer silence is shown as this, like in a replay

/** The strokes of the live session that this page has seen, and whose they are: a part of the panel. */
export class LiveStrokes {
  private bars: Bar[] = [];
  private clock_ms = 0;
  private arrived_ms = NaN; // of the last step, on the server's clock
  private waiting = false;
  readonly timeline: Timeline;

  constructor(private readonly names: BladeNames) {
    const canvas = element<HTMLCanvasElement>("live-timeline");
    this.timeline = new Timeline(
      canvas,
      canvas,
      (bar) => cssColour(bar.source, bar.own),
      (bar) => this.titleOf(bar),
      "Strokes that this page has seen; long pauses are shortened. Click on one for its figures",
    );
    canvas.addEventListener("click", (e) => {
      const bar = this.timeline.barAt(e);
      this.timeline.chosen = bar === this.timeline.chosen ? undefined : bar;
      this.showChosen();
      this.timeline.draw();
    });
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

  /** Whose strokes the bars are. To be called when names have come, too. */
  showBlades(): void {
    element("live-strokes").hidden = this.bars.length === 0;
    this.showChosen();
    // After a takeover a source has strokes of two hands.
    const seen = new Map(this.bars.map(({ source, own }) => [`${source},${own}`, { source, own }]));
    element("blades").replaceChildren(
      ...[...seen.values()].map(({ source, own }) => {
        const item = document.createElement("li");
        const swatch = document.createElement("i");
        swatch.style.background = cssColour(source, own);
        item.append(swatch, this.names.of(source) + (own ? " (you)" : ""));
        return item;
      }),
    );
  }

  /** The figures of the stroke that was clicked, while it is there. */
  private showChosen(): void {
    const { timeline } = this;
    if (timeline.chosen && !this.bars.includes(timeline.chosen)) timeline.chosen = undefined;
    element("stroke-text").hidden = !timeline.chosen;
    element("stroke-text").textContent = timeline.chosen ? this.titleOf(timeline.chosen) : "";
  }

  private titleOf(bar: Bar): string {
    const whose = bar.own ? "Your stroke" : `Stroke of ${this.names.of(bar.source)}`;
    const area = number((bar.cutArea_m2 ?? 0) * 1e4, 1);
    return `${whose}: ${seconds(bar.to_ms - bar.from_ms)} s, ${area} cm² when it was cut, revisions ${bar.first} to ${bar.last}`;
  }

  /** At most once a frame. */
  private showSoon(): void {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.showBlades();
      this.timeline.show(this.bars, this.bars[0]?.from_ms ?? 0, this.clock_ms);
    });
  }
}
