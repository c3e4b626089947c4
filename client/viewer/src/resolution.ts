const kSlow_ms = 34; // two frames of a 60 Hz screen: 30 frames a second
const kQuick_ms = 20; // about one frame of a 60 Hz screen
const kHitch_ms = 80;
const kFramesToJudge = 6;
const kFramesToTrust = 120; // quick frames, before more pixels are tried
const kMostFramesToTrust = 3600;

/** Shares of the full resolution, from sharp to quick. */
export const kScales = [1, 0.85, 0.7, 0.6, 0.5];

/**
 * How many pixels a moving picture gets: fewer, step by step, while frames are slow; more after many quick frames. A
 * step up that proves too slow is undone at once, and the next one waits twice as long, so that the resolution does
 * not oscillate.
 */
export class Resolution {
  private step: number;
  private average_ms = 0;
  private frames = 0; // since the last step
  private framesToTrust = kFramesToTrust;
  private raised = false; // the last step was upwards

  constructor(slowMachine: boolean) {
    this.step = slowMachine ? 3 : 0;
  }

  get scale(): number {
    return kScales[this.step];
  }

  /** A frame was drawn, and the next one began so much later. True: the scale has changed. */
  took(frame_ms: number): boolean {
    frame_ms = Math.min(frame_ms, kHitch_ms); // a single hitch must not decide
    this.average_ms += (frame_ms - this.average_ms) / Math.min(++this.frames, kFramesToJudge);
    if (this.frames < kFramesToJudge) return false;
    if (this.average_ms > kSlow_ms && this.step < kScales.length - 1) {
      if (this.raised) this.framesToTrust = Math.min(2 * this.framesToTrust, kMostFramesToTrust);
      return this.go(1);
    }
    return this.average_ms < kQuick_ms && this.frames >= this.framesToTrust && this.step > 0 && this.go(-1);
  }

  private go(by: 1 | -1): true {
    this.step += by;
    this.raised = by < 0;
    this.frames = 0;
    return true;
  }
}
