import { Chart } from "./chart";
import { element, number } from "./dom";
import { Latency } from "./latency";
import type { Progress } from "./messages";

const kEvery_ms = 500;
const kNoticed_ms = 100; // a delay that a hand notices (Miller 1968)
const kLatencyStays = 4; // looks without a pose, after which the last latency is no longer shown

/** What is shown of the server's /stats, whose keys may change. */
interface ServerStats {
  stages_us?: { frame_work?: { sum: number; count: number } };
  frames?: { rate_hz: number };
  backlog?: { segments: number; work_ms: number };
}

/** The figures and charts of the panel. */
export class Figures {
  progress: Progress | null = null;
  readonly latency = new Latency();
  private looksWithoutPose = 0;
  private shownLatency_ms = NaN; // NaN: none is shown
  private agrees: boolean | null = null; // null: no state yet
  private readonly source: string;
  private live = true;
  private last = { deltas: 0, bytes: 0, work_us: 0, frames: 0 };
  private readonly charts = {
    latency: new Chart(element<HTMLCanvasElement>("latency-chart"), 20, 2, kNoticed_ms),
    budget: new Chart(element<HTMLCanvasElement>("budget-chart"), 100, 1, 100),
    backlog: new Chart(element<HTMLCanvasElement>("backlog-chart"), 10, 1),
    deltas: new Chart(element<HTMLCanvasElement>("deltas-chart"), 5),
  };

  /** local: a session in this page computes the hashes that those of the picture are compared with, not a server. */
  constructor(local = false) {
    this.source = local ? "session in this page" : "server";
    element("hash-row").title =
      `This page computes a hash of what it shows, and compares it with that of the ${this.source}`;
    setInterval(() => this.showRates(), kEvery_ms);
    element("details").addEventListener("toggle", () => this.draw());
  }

  draw(): void {
    for (const chart of Object.values(this.charts)) chart.draw();
  }

  show(progress: Progress): void {
    this.progress = progress;
    element("revision").textContent = number(progress.revision);
    element("pieces").textContent = number(progress.pieces);
    element("tets").textContent = number(progress.tets);
    element("hash").textContent = progress.hash;
  }

  /**
   * Whether the hash computed here is the server's. If not, the light stays red until the whole state has been loaded
   * again.
   */
  showTrust(agrees: boolean): void {
    this.agrees = agrees;
    this.drawTrust();
  }

  /** Whether the server answers: without it nothing is checked, and the figures are the last ones. */
  showLive(live: boolean): void {
    document.body.dataset.live = live ? "yes" : "no";
    this.live = live;
    this.drawTrust();
  }

  private drawTrust(): void {
    if (this.agrees === null) return;
    element("hash-row").dataset.agrees = this.live ? String(this.agrees) : "unknown";
    element("hash-text").textContent = !this.live
      ? "Not checked: no answer"
      : this.agrees
        ? `Checked: it agrees with the ${this.source}`
        : `It differs from the ${this.source}: loading it again`;
  }

  showCutArea(area_m2: number): void {
    element("cut-area").textContent = number(area_m2 * 1e4, 1);
  }

  /** json: the server's statistics. */
  showStats(json: string): void {
    let stats: ServerStats;
    try {
      stats = JSON.parse(json);
    } catch {
      return;
    }
    this.showBudget(stats.stages_us?.frame_work, stats.frames?.rate_hz ?? 1000);
    const segments = stats.backlog?.segments ?? 0;
    this.charts.backlog.push(segments);
    element("backlog").textContent =
      segments > 0 ? `${number(segments)} segments, ${number(stats.backlog?.work_ms ?? 0)} ms` : "none";
  }

  private showBudget(work: { sum: number; count: number } | undefined, rate_hz: number): void {
    if (work?.sum === undefined) return;
    const frames = work.count - this.last.frames;
    const share = frames > 0 ? ((work.sum - this.last.work_us) / frames / (1e6 / rate_hz)) * 100 : 0;
    if (this.last.frames > 0 && frames >= 0) {
      this.charts.budget.push(share);
      element("budget").textContent = `${number(share, share < 10 ? 1 : 0)}%`;
    }
    this.last.work_us = work.sum;
    this.last.frames = work.count;
  }

  private showRates(): void {
    const p = this.progress;
    if (!p) return;
    const seconds = kEvery_ms / 1000;
    const deltas = (p.deltas - this.last.deltas) / seconds;
    const bytes = (p.bytes - this.last.bytes) / seconds;
    this.last.deltas = p.deltas;
    this.last.bytes = p.bytes;
    this.charts.deltas.push(deltas);
    element("deltas").textContent = deltas > 0 ? `${number(deltas)}/s, ${number(bytes / 1024)} KiB/s` : "none";
    const median = this.latency.takeMedian();
    this.looksWithoutPose = median === undefined ? this.looksWithoutPose + 1 : 0;
    if (median !== undefined) this.shownLatency_ms = median;
    else if (this.looksWithoutPose >= kLatencyStays) this.shownLatency_ms = NaN;
    element("latency").textContent = Number.isNaN(this.shownLatency_ms) ? "–" : `${number(this.shownLatency_ms)} ms`;
    this.charts.latency.push(median ?? 0, this.shownLatency_ms);
  }
}
