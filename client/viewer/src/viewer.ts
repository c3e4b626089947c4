import type { Blade } from "./blade";
import { sideArea } from "./cut_sides";
import { Link, type HelloFields } from "./link";
import { fetchLook } from "./look_source";
import type { Post, Progress, ReplayFacts, ToWorker } from "./messages";
import { measureFaces } from "./opening";
import { PageFeed } from "./page_feed";
import { Replica } from "./replica";
import { hex } from "./state_hash";
import { kNone } from "./surface";
import { documentsOf, fetchTexture } from "./texture_source";
import type { Revisions } from "./timeline";
import { BladePose } from "./wire/incise/wire/blade-pose";
import { Body } from "./wire/incise/wire/body";
import type { Message } from "./wire/incise/wire/message";
import { ReplayAction } from "./wire/incise/wire/replay-action";
import { ReplayControl } from "./wire/incise/wire/replay-control";
import { ReplayState } from "./wire/incise/wire/replay-state";
import { RestartKind } from "./wire/incise/wire/restart-kind";
import { Resync } from "./wire/incise/wire/resync";
import { Role } from "./wire/incise/wire/role";
import { SnapshotBegin } from "./wire/incise/wire/snapshot-begin";
import { SnapshotChunk } from "./wire/incise/wire/snapshot-chunk";
import { SnapshotEnd } from "./wire/incise/wire/snapshot-end";
import { Recording } from "./wire/incise/wire/recording";
import { Stats } from "./wire/incise/wire/stats";
import type { Step } from "./wire/incise/wire/step";
import { SurfaceDelta } from "./wire/incise/wire/surface-delta";
import { vec } from "./wire_vec";
import { View } from "./wire/incise/wire/view";
import type { Welcome } from "./wire/incise/wire/welcome";

const kBladeRate_hz = 60;
const kReplayActions = {
  open: ReplayAction.Open,
  play: ReplayAction.Play,
  pause: ReplayAction.Pause,
  step: ReplayAction.Step,
  seek: ReplayAction.Seek,
  close: ReplayAction.Close,
};

function timelineOf(state: ReplayState): Revisions | undefined {
  const [ms, sources, strokes] = [state.revisionMsArray(), state.revisionSourcesArray(), state.revisionStrokesArray()];
  if (!ms || ms.length === 0 || sources?.length !== ms.length || strokes?.length !== ms.length) return undefined;
  return { ms: [...ms], sources: [...sources], strokes: [...strokes] };
}

/** Who has reset the body or undone a stroke; "": the server does not say. */
function askedBy(welcome: Welcome): string {
  const restart = welcome.restart();
  const by = restart?.by();
  if (!restart || !by) return "";
  return restart.role() === Role.Operator ? `the operator of blade ${by}` : `administrator ${by}`;
}

/**
 * The page's view of the session: the connection that brings the state, its replica, and the feed to the page. Thread:
 * the worker's.
 */
export class Viewer {
  private link: Link | null = null;
  private token = "";
  private readonly replica = new Replica((revision, hash, reason) => {
    if (!this.replica.agrees) this.post({ kind: "differs" });
    this.link?.send(Body.Resync, (b) => Resync.createResync(b, revision, hash, b.createString(reason)));
  });
  readonly feed: PageFeed;
  private url = "";
  private assetHash = ""; // of the surface whose texture is shown, or asked for
  private lookText = ""; // what the look that is shown was made of
  private readonly figures = { tets: 0, deltas: 0, bytes: 0 };
  private justConnected = false; // no Welcome yet on this connection
  private liveSession = 0n;
  private replayAsked = false; // from the request for a replay until the live mesh is back
  replaying = false; // a recording is shown; Stats are still of the live mesh
  private deforms = false;
  private readonly felt = new Set<number>(); // sources with a force
  /** Replaying has begun or ended. */
  onReplaying: () => void = () => {};

  constructor(
    private readonly blade: Blade,
    private readonly post: Post,
  ) {
    this.feed = new PageFeed(this.replica.surface, () => this.progress(), post);
  }

  connect(url: string, token: string): void {
    this.link?.end();
    this.url = url;
    this.token = token;
    this.link = new Link(url, {
      hello: () => this.hello(),
      welcome: (welcome) => this.onWelcome(welcome),
      message: (type, message, bytes) => this.onMessage(type, message, bytes),
      state: (state) => this.post({ kind: "link", which: "view", state }),
      refused: (text) => {
        if (!this.replaying) this.replayAsked = false;
        this.post({ kind: "notice", text });
      },
      unreadable: () => this.replica.distrust(),
    });
  }

  wake(): void {
    this.link?.wake();
  }

  drop(): void {
    this.link?.drop();
  }

  controlReplay(wish: ToWorker & { kind: "replay" }): void {
    if (wish.action === "open") this.replayAsked = true;
    this.link?.send(Body.ReplayControl, (b) =>
      ReplayControl.createReplayControl(
        b,
        kReplayActions[wish.action],
        b.createString(wish.capture ?? ""),
        wish.speed ?? 1,
        BigInt(wish.revision ?? 0),
      ),
    );
  }

  measureCut(halfFace: number): void {
    const { surface } = this.replica;
    const slot = surface.slotFor(halfFace);
    if (slot < 0) return;
    this.post({ kind: "cut-area", halfFace, area_m2: sideArea(surface, measureFaces(surface), slot) });
  }

  /** All triangles, 9 numbers each. */
  dump(): Float32Array {
    const { surface } = this.replica;
    const triangles = new Float32Array(9 * surface.triangleCount);
    let at = 0;
    for (let s = 0; s < surface.slots; ++s) {
      if (surface.ids[s] === kNone) continue;
      for (let k = 0; k < 3; ++k, at += 3) {
        const v = 3 * surface.corners[3 * s + k];
        triangles.set(surface.positions.subarray(v, v + 3), at);
      }
    }
    return triangles;
  }

  private progress(): Progress {
    const { replica, figures } = this;
    return {
      revision: Number(replica.revision),
      triangles: replica.surface.triangleCount,
      pieces: replica.surface.pieceCount,
      hash: hex(replica.stateHash),
      hashAgrees: replica.agrees,
      ...figures,
    };
  }

  private hello(): HelloFields {
    const { holding, session, revision, stateHash } = this.replica;
    this.justConnected = true;
    this.showReplay(null); // it ended with the connection
    return {
      role: Role.Viewer,
      view: View.Surface,
      token: this.token,
      bladeRate_hz: kBladeRate_hz,
      resumeSession: holding ? session : 0n,
      resumeRevision: holding ? revision : 0n,
      resumeHash: holding ? stateHash : 0n,
    };
  }

  private onWelcome(welcome: Welcome): void {
    const mesh = welcome.mesh();
    const box = mesh?.box();
    const min = vec(box?.min()),
      max = vec(box?.max());
    this.feed.bodySize_m = Math.hypot(max[0] - min[0], max[1] - min[1], max[2] - min[2]) || 1;
    this.feed.builder.grainCells = 55 / this.feed.bodySize_m;
    this.replica.welcome(welcome);
    void this.showTexture(welcome.surface()?.path() ?? "", welcome.surface()?.contentHash() ?? "");
    if (this.justConnected) void this.showLook();
    if (!this.replica.holding) this.feed.pause();
    const { session } = this.replica;
    if (!this.replayAsked) {
      if (!this.justConnected && session !== this.liveSession) {
        const restart = welcome.restart();
        // An older server does not say what it was.
        const undone = restart ? restart.kind() === RestartKind.Undo : welcome.revision() > 0n;
        const others = Array.from({ length: restart?.othersLength() ?? 0 }, (_, i) => restart?.others(i) ?? "");
        this.post({ kind: "was-reset", undone, by: askedBy(welcome), others });
      }
      this.liveSession = session;
    }
    this.justConnected = false;
    this.post({
      kind: "facts",
      facts: {
        session: hex(session),
        meshName: mesh?.name() ?? "",
        tets: mesh?.tets() ?? 0,
        vertices: mesh?.vertices() ?? 0,
        meanEdge_m: mesh?.meanEdgeLengthM() ?? 0,
        min,
        max,
        policy: welcome.policy() ?? "",
        server: `${welcome.serverName()} ${welcome.serverVersion()}`,
        frameRate_hz: welcome.frameRateHz(),
        revision: Number(welcome.revision()),
        live: !this.replayAsked,
      },
    });
  }

  private async showTexture(path: string, hash: string): Promise<void> {
    if (hash === this.assetHash) return;
    this.assetHash = hash;
    this.feed.setTexture(null);
    if (!path) return;
    try {
      const found = await fetchTexture(documentsOf(this.url), path, this.token);
      if (!found || hash !== this.assetHash) return;
      this.post({ kind: "texture", ...found.texture }, [found.texture.pixels.buffer]);
      this.feed.setTexture(found.asset);
      this.nameUndecoded(found.undecoded);
    } catch (error) {
      this.assetHash = ""; // asked for again with the next Welcome
      this.post({
        kind: "notice",
        text: `The body's texture is not shown: ${error instanceof Error ? error.message : error}`,
      });
    }
  }

  /** Once a connection: what the server says may be new after a restart. */
  private async showLook(): Promise<void> {
    const found = await fetchLook(documentsOf(this.url), this.token);
    if (!found || found.text === this.lookText) return;
    this.lookText = found.text;
    try {
      const look = await found.load();
      if (found.text !== this.lookText) return;
      this.feed.setRegions(look.regions.map((r) => r.region));
      const images = [look.image?.samples, look.regionImage?.samples, look.textures?.pixels];
      this.post(
        { kind: "look", look },
        images.flatMap((bytes) => (bytes ? [bytes.buffer] : [])),
      );
      this.nameUndecoded(look.undecoded);
    } catch (error) {
      this.lookText = ""; // asked for again with the next connection
      this.post({
        kind: "notice",
        text: `The body's inside is not shown as its server says: ${error instanceof Error ? error.message : error}`,
      });
    }
  }

  private nameUndecoded(paths: string[]): void {
    if (paths.length === 0) return;
    const what = paths.length === 1 ? `The texture ${paths[0]} is` : `The textures ${paths.join(", ")} are`;
    this.post({
      kind: "notice",
      text: `${what} no image that this browser can decode. A plain colour is shown instead.`,
    });
  }

  private onMessage(type: Body, message: Message, bytes: number): void {
    this.figures.bytes += bytes;
    switch (type) {
      case Body.SnapshotBegin:
        return this.onSnapshot(message.body(new SnapshotBegin()));
      case Body.SnapshotChunk:
        return this.replica.addChunk(message.body(new SnapshotChunk()));
      case Body.SnapshotEnd:
        if (this.replica.endSnapshot(message.body(new SnapshotEnd()))) this.feed.restart();
        return;
      case Body.SurfaceDelta:
        return this.onDelta(message.body(new SurfaceDelta()));
      case Body.BladePose:
        return this.onBladePose(message.body(new BladePose()));
      case Body.Stats:
        return this.onStats(message.body(new Stats()));
      case Body.ReplayState:
        return this.onReplayState(message.body(new ReplayState()));
    }
  }

  private onSnapshot(begin: SnapshotBegin): void {
    this.replica.beginSnapshot(begin);
    this.figures.tets = begin.tetCount();
  }

  private onDelta(delta: SurfaceDelta): void {
    if (!this.replica.apply(delta)) return;
    this.figures.tets = delta.liveTets();
    ++this.figures.deltas;
    for (let i = 0; i < delta.stepsLength(); ++i) this.onStep(delta.steps(i)!);
    this.feed.sendChanges();
  }

  private onStep(step: Step): void {
    if (step.stroke() === 0) {
      if (!this.deforms) this.post({ kind: "deforms" });
      this.deforms = true;
      return;
    }
    const own = !this.replaying && this.blade.owns(step.source());
    this.feed.addStep(
      {
        source: step.source(),
        own,
        stroke: step.stroke(),
        revision: Number(step.revision()),
        arrived_ms: Number(step.arrivalNs() / 1000n) / 1e3,
        heel: vec(step.toHeel()),
        tip: vec(step.toTip()),
        ended: step.strokeEnded(),
        cutArea_m2: step.cutAreaM2(),
      },
      this.posedAt_ms(step, own),
    );
  }

  /** When the step's last pose was made. 0 in a replay. */
  private posedAt_ms(step: Step, own: boolean): number {
    if (this.replaying) return 0;
    const arrived_ns = step.arrivalNs() - (this.link?.clockOffset_ns ?? 0n);
    // The mouse's clock may be ahead: a flick takes longer on it.
    const posed_ns = own && step.toSourceNs() < arrived_ns ? step.toSourceNs() : arrived_ns;
    return Number(posed_ns / 1000n) / 1e3;
  }

  private onBladePose(pose: BladePose): void {
    const source = pose.source(),
      own = this.blade.owns(source);
    const heel = vec(pose.heel()),
      tip = vec(pose.tip());
    const newtons = vec(pose.forceN());
    // At the tip, where the body dents; of a blade that cuts, whose tip is hidden, where it goes in. The heel of one's own is at the eye.
    const at = pose.cutting() && !own ? heel : tip;
    if (newtons.some((n) => n !== 0) || this.felt.has(source))
      this.post({ kind: "force", force: { source, at, newtons } });
    this.felt.delete(source);
    if (newtons.some((n) => n !== 0)) this.felt.add(source);
    if (own) return; // the page draws that one itself
    this.post({ kind: "blade-pose", source, heel, tip, cutting: pose.cutting() });
  }

  private onStats(stats: Stats): void {
    this.post({
      kind: "stats",
      json: stats.json() ?? "{}",
      roundTrip_ms: this.link?.roundTrip_ms ?? 0,
      recorded: stats.recording() !== Recording.Off,
      undoable: stats.undoable(),
    });
  }

  private onReplayState(state: ReplayState): void {
    const capture = state.capture() ?? "";
    this.showReplay(
      capture === ""
        ? null
        : {
            capture,
            playing: state.playing(),
            speed: state.speed(),
            revision: Number(state.revision()),
            lastRevision: Number(state.lastRevision()),
            text: state.text() ?? "",
            timeline: timelineOf(state),
          },
    );
  }

  private showReplay(facts: ReplayFacts | null): void {
    const was = this.replaying;
    this.replaying = facts !== null;
    if (!this.replaying) this.replayAsked = false;
    if (was !== this.replaying) this.onReplaying();
    if (was || this.replaying) this.post({ kind: "replay", facts });
  }
}
