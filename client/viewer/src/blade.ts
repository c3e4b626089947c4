import { Link, type LinkState } from "./link";
import type { Post } from "./messages";
import { Body } from "./wire/incise/wire/body";
import { PoseBatch } from "./wire/incise/wire/pose-batch";
import { PoseSample } from "./wire/incise/wire/pose-sample";
import { Role } from "./wire/incise/wire/role";
import { Undo } from "./wire/incise/wire/undo";
import { View } from "./wire/incise/wire/view";
import type { Welcome } from "./wire/incise/wire/welcome";
import { vec } from "./wire_vec";

const kNumbersPerPose = 9;

/**
 * The mouse's blade. It has a connection of its own: one may be allowed to watch and not to cut.
 * Thread: the worker's.
 */
export class Blade {
  private link: Link | null = null;
  private source = -1;
  private name = "mouse";
  private taken: [url: string, token: string, length_m: number] = ["", "", 0]; // with what it was taken last

  constructor(private readonly post: Post) {}

  /** Whether poses of this source are the mouse's. */
  owns(source: number): boolean {
    return source === this.source && this.link?.open === true;
  }

  take(url: string, token: string, takeOver: boolean, length_m: number): void {
    this.release();
    this.taken = [url, token, length_m];
    this.link = new Link(url, {
      hello: () => ({
        role: Role.Operator,
        view: View.None,
        token,
        sourceName: this.name,
        takeOver,
        blade: { heel: [0, 0, 0], tip: [0, 0, -length_m] },
      }),
      welcome: (welcome) => {
        takeOver = true; // after a lost connection the server may still hold it for us
        this.onWelcome(welcome);
      },
      message: () => {},
      state: (state) => this.onState(state),
      refused: (text) => this.post({ kind: "notice", text }),
      unreadable: () => {},
    });
  }

  /** From here on it has this name: a blade that is held is given up for the one of that name. */
  rename(name: string): void {
    if (name === this.name) return;
    this.name = name;
    const [url, token, length_m] = this.taken;
    if (this.link) this.take(url, token, false, length_m);
  }

  release(): void {
    this.link?.end();
    this.link = null;
  }

  wake(): void {
    this.link?.wake();
  }

  /** Asks for the state before the last stroke, also where other blades have cut since. False: there is no connection. */
  undo(others: boolean): boolean {
    return (this.link?.send(Body.Undo, (b) => Undo.createUndo(b, others)) ?? 0n) > 0n;
  }

  /** 9 numbers a pose: time in ms, position, quaternion w x y z, buttons. */
  send(poses: Float64Array): void {
    const count = poses.length / kNumbersPerPose;
    this.link?.send(Body.PoseBatch, (b) => {
      PoseBatch.startPosesVector(b, count);
      for (let i = count - 1; i >= 0; --i) {
        const at = kNumbersPerPose * i;
        const time_ns = BigInt(Math.round(poses[at] * 1e3)) * 1000n;
        PoseSample.createPoseSample(
          b,
          time_ns,
          poses[at + 1],
          poses[at + 2],
          poses[at + 3],
          poses[at + 4],
          poses[at + 5],
          poses[at + 6],
          poses[at + 7],
          poses[at + 8],
          0,
        );
      }
      return PoseBatch.createPoseBatch(b, b.endVector());
    });
  }

  private onWelcome(welcome: Welcome): void {
    this.source = welcome.source();
    this.post({
      kind: "blade",
      facts: {
        heel: vec(welcome.bladeHeel()),
        tip: vec(welcome.bladeTip()),
        source: this.source,
        name: this.name,
        engageButton: welcome.engageButton(),
        maxSpeed_m_s: welcome.maxSpeedMS(),
      },
    });
  }

  private onState(state: LinkState): void {
    if (state.stage === "ended") this.link = null;
    this.post({ kind: "link", which: "blade", state });
  }
}
