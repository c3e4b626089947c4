const kMost_ms = 60_000;

/** The time from a pose to the moment its effect is on the screen. Absolute times, ms. */
export class Latency {
  private values: number[] = [];
  private visibleSince_ms = 0;
  private posed_ms = 0; // of the frame that is being drawn; 0: it shows no new pose

  /** The page has become visible: poses from before are not measured. */
  seen(now_ms: number): void {
    this.visibleSince_ms = now_ms;
  }

  /** The next frame shows the effect of this pose; 0: of no pose. */
  expect(posed_ms: number): void {
    this.posed_ms = posed_ms >= this.visibleSince_ms ? posed_ms : 0;
  }

  /** A frame was drawn. Returns a function to call when it is on the screen, or null if it shows no new pose. */
  drawn(): ((now_ms: number) => void) | null {
    if (this.posed_ms === 0) return null;
    const posed_ms = this.posed_ms;
    this.posed_ms = 0;
    return (now_ms) => {
      const latency = now_ms - posed_ms;
      if (latency >= 0 && latency < kMost_ms) this.values.push(latency);
    };
  }

  /** The median since the last call; undefined if nothing was measured. */
  takeMedian(): number | undefined {
    const sorted = this.values.sort((a, b) => a - b);
    this.values = [];
    return sorted[sorted.length >> 1];
  }
}
