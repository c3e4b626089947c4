const kMost_ms = 60_000;

/** From when a pose was made to when the picture that shows it is on the screen. Absolute times, ms. */
export class Latency {
  private values: number[] = [];
  private visibleSince_ms = 0;
  private posed_ms = 0; // of the picture that is on its way to the screen; 0: no pose is behind it

  /** The page has become visible: what was cut while nobody saw it says nothing. */
  seen(now_ms: number): void {
    this.visibleSince_ms = now_ms;
  }

  /** The next picture shows the state that this pose led to. */
  expect(posed_ms: number): void {
    this.posed_ms = posed_ms >= this.visibleSince_ms ? posed_ms : 0;
  }

  /** A picture was drawn: a function to call when it is on the screen, or null where no pose is behind it. */
  drawn(): ((now_ms: number) => void) | null {
    if (this.posed_ms === 0) return null;
    const posed_ms = this.posed_ms;
    this.posed_ms = 0;
    return (now_ms) => {
      const latency = now_ms - posed_ms;
      if (latency >= 0 && latency < kMost_ms) this.values.push(latency);
    };
  }

  /** The median since the last call; undefined where there was none. */
  takeMedian(): number | undefined {
    const sorted = this.values.sort((a, b) => a - b);
    this.values = [];
    return sorted[sorted.length >> 1];
  }
}
