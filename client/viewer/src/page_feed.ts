import { allocateCorners, CornerBuilder, type Corners, kRim } from "./corner_buffers";
import type { BladeStep, Post, Progress } from "./messages";
import { computeOpening, type Opening } from "./opening";
import { SkinDepth } from "./skin_depth";
import { kNone, type Surface } from "./surface";
import type { SurfaceAsset } from "./surface_asset";

const kOpeningPause_ms = 120; // between two computations of how the body opens
const kMostSteps = 256; // kept for a page that is hidden

function transferable(c: Corners): Transferable[] {
  return [
    c.ids.buffer,
    c.positions.buffer,
    c.normals.buffer,
    c.facts.buffer,
    c.rest.buffer,
    c.texture.buffer,
    c.regions.buffer,
  ];
}

/** Sends the surface to the page: first all of it, then changes, one patch at a time. Thread: the worker's. */
export class PageFeed {
  readonly builder: CornerBuilder;
  bodySize_m = 1;
  private capacity = 0; // slots that the page has room for
  private sentDeformed = false; // the page has rest positions
  private ready = false; // the page has the whole surface
  private waiting = false; // the page has not applied the last patch yet
  private steps: BladeStep[] = [];
  private posed_ms = 0; // of the last pose whose effect is not sent yet
  private readonly opening: Opening = { lips: new Float32Array(0), pieces: new Float32Array(0), cutArea_m2: 0 };
  private openingCost_ms = 0;
  private openingTimer: ReturnType<typeof setTimeout> | undefined;

  constructor(
    private readonly surface: Surface,
    private readonly progress: () => Progress,
    private readonly post: Post,
  ) {
    this.builder = new CornerBuilder(surface);
  }

  /** The whole surface was replaced: sends everything. */
  restart(): void {
    this.builder.restart();
    this.builder.skin = new SkinDepth(this.surface, kRim * this.bodySize_m);
    this.numberPieces();
    this.sendAll();
  }

  /** The body's texture, or none from here on. */
  setTexture(asset: SurfaceAsset | null): void {
    if (this.builder.asset === asset) return;
    this.builder.asset = asset;
    if (this.ready) this.sendAll();
  }

  /** The regions that look differently, in the order of the look's list; empty: all look the same. */
  setRegions(regions: number[]): void {
    this.builder.regionIndex = new Map(regions.map((region, i) => [region, i]));
    if (this.ready) this.sendAll();
  }

  /** Sends nothing until restart(): the surface belongs to another session. */
  pause(): void {
    this.ready = false;
  }

  /** Adds a blade's step to the next patch; posed_ms: when its last pose was made, 0: unknown. */
  addStep(step: BladeStep, posed_ms: number): void {
    this.steps.push(step);
    this.posed_ms = posed_ms;
    if (this.steps.length > kMostSteps) this.steps.shift();
  }

  /** The page has applied the last patch. */
  applied(): void {
    this.waiting = false;
    this.sendChanges();
  }

  /** Sends what has changed. While the page has not applied the last patch, changes are gathered instead. */
  sendChanges(): void {
    const { surface, builder } = this;
    if (!this.ready || this.waiting) return;
    if (surface.slots > this.capacity || surface.deformed !== this.sentDeformed) return this.sendAll();
    if (surface.touchedSlots.size === 0 && surface.touchedVertices.size === 0 && this.steps.length === 0) return;
    const slots = builder.touched();
    const corners = this.cornersOf(slots, slots.length);
    surface.clearTouched();
    this.waiting = true;
    const patch = { slots, highest: surface.slots, corners, steps: this.steps, posed_ms: this.posed_ms };
    this.post({ kind: "patch", ...patch, progress: this.progress() }, [slots.buffer, ...transferable(corners)]);
    this.forgetSteps();
    // Of a large body it must not occupy the worker.
    this.scheduleOpening(Math.max(kOpeningPause_ms, 8 * this.openingCost_ms));
  }

  private sendAll(): void {
    const { surface } = this;
    this.ready = true;
    this.sentDeformed = surface.deformed;
    this.builder.measureAll();
    this.capacity = Math.ceil(surface.slots * 1.4) + 4096;
    const all = this.cornersOf(null, surface.slots);
    surface.clearTouched();
    this.forgetSteps();
    this.post(
      { kind: "geometry", slots: surface.slots, capacity: this.capacity, corners: all, progress: this.progress() },
      transferable(all),
    );
    this.scheduleOpening(0);
  }

  private forgetSteps(): void {
    this.steps = [];
    this.posed_ms = 0;
  }

  private cornersOf(slots: Uint32Array | null, count: number): Corners {
    const out = allocateCorners(
      count,
      this.builder.asset !== null,
      this.surface.deformed,
      this.builder.regionIndex.size > 0,
    );
    for (let i = 0; i < count; ++i) this.builder.write(slots ? slots[i] : i, out, i);
    return out;
  }

  private numberPieces(): void {
    for (let s = 0; s < this.surface.slots; ++s) this.builder.rowOf(this.surface.pieces[s]);
  }

  private scheduleOpening(pause_ms: number): void {
    this.openingTimer ??= setTimeout(() => {
      this.openingTimer = undefined;
      if (this.ready) this.sendOpening();
    }, pause_ms);
  }

  private sendOpening(): void {
    const { surface, builder, opening } = this;
    const began_ms = performance.now();
    computeOpening(surface, (piece) => builder.rowOf(piece), builder.rowCount, this.bodySize_m, opening);
    const lips = new Float32Array(9 * surface.slots);
    for (let c = 0; c < 3 * surface.slots; ++c) {
      if (surface.ids[(c / 3) | 0] === kNone) continue;
      const v = 3 * surface.corners[c];
      lips[3 * c] = opening.lips[v];
      lips[3 * c + 1] = opening.lips[v + 1];
      lips[3 * c + 2] = opening.lips[v + 2];
    }
    const pieces = opening.pieces.slice(0, 4 * builder.rowCount);
    this.post({ kind: "opening", lips, pieces, cutArea_m2: opening.cutArea_m2 }, [lips.buffer, pieces.buffer]);
    this.openingCost_ms = performance.now() - began_ms;
  }
}
