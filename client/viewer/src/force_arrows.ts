import { Vector3 } from "three";
import type { BladeForce } from "./messages";
import type { Marks } from "./marks";

const kLast_ms = 250; // without news of it
const kLength = 0.04,
  kLongest = 0.3; // of an arrow, times the body's size: for each newton, and at most
const kHead = 0.2,
  kLargestHead = 0.03; // of its length, and times the body's size
const kWeakest_n = 0.02;

/** The force on each hand, as an arrow with its newtons at its blade. */
export class ForceArrows {
  private readonly forces = new Map<number, { force: BladeForce; at_ms: number }>();
  private alarm: ReturnType<typeof setTimeout> | undefined;

  constructor(
    private readonly marks: Marks,
    private readonly bodySize_m: () => number,
    private readonly now_ms = () => performance.now(),
  ) {
    marks.layers.push(() => this.draw());
  }

  take(force: BladeForce): void {
    this.forces.set(force.source, { force, at_ms: this.now_ms() });
    clearTimeout(this.alarm);
    this.alarm = setTimeout(() => this.marks.draw(), kLast_ms + 1);
  }

  private draw(): void {
    for (const { force, at_ms } of this.forces.values()) {
      const newtons = Math.hypot(...force.newtons);
      if (newtons < kWeakest_n || this.now_ms() - at_ms > kLast_ms) continue;
      const from = new Vector3(...force.at);
      const size = this.bodySize_m();
      const along = new Vector3(...force.newtons).setLength(size * Math.min(kLength * newtons, kLongest));
      const to = from.clone().add(along);
      this.marks.arrow(from, to, Math.min(kHead * along.length(), kLargestHead * size));
      this.marks.label(to, `${newtons.toFixed(newtons < 10 ? 2 : 1)} N`);
    }
  }
}
