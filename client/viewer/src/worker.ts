// The page's side of the stream, off its main thread: connections, the state, its hash, and the corners to be drawn.

import { allocateCorners, type Corners, CornerBuilder } from "./corner_buffers";
import { Elements } from "./elements";
import { type HelloFields, Link, type LinkState, now_ns } from "./link";
import type { BladeStep, FromWorker, Progress, ToWorker, Vec3 } from "./messages";
import { computeOpening, type Opening } from "./opening";
import { hex } from "./state_hash";
import { kNone, Surface } from "./surface";
import { BladePose } from "./wire/incise/wire/blade-pose";
import { Body } from "./wire/incise/wire/body";
import { Delta } from "./wire/incise/wire/delta";
import type { Message } from "./wire/incise/wire/message";
import { PoseBatch } from "./wire/incise/wire/pose-batch";
import { PoseSample } from "./wire/incise/wire/pose-sample";
import { ReplayAction } from "./wire/incise/wire/replay-action";
import { ReplayControl } from "./wire/incise/wire/replay-control";
import { ReplayState } from "./wire/incise/wire/replay-state";
import { Reset } from "./wire/incise/wire/reset";
import { Resync } from "./wire/incise/wire/resync";
import { Role } from "./wire/incise/wire/role";
import { SnapshotBegin } from "./wire/incise/wire/snapshot-begin";
import { SnapshotChunk } from "./wire/incise/wire/snapshot-chunk";
import { SnapshotEnd } from "./wire/incise/wire/snapshot-end";
import { Stats } from "./wire/incise/wire/stats";
import { StrokeAction } from "./wire/incise/wire/stroke-action";
import { StrokeControl } from "./wire/incise/wire/stroke-control";
import { SurfaceDelta } from "./wire/incise/wire/surface-delta";
import type { Vec3 as WireVec3 } from "./wire/incise/wire/vec3";
import { View } from "./wire/incise/wire/view";
import type { Welcome } from "./wire/incise/wire/welcome";

const kNumbersPerPose = 9;
const kElementsRate_hz = 20;
const kOpeningPause_ms = 120; // between two looks at how the body opens

const surface = new Surface();
const builder = new CornerBuilder(surface);
const opening: Opening = { lips: new Float32Array(0), pieces: new Float32Array(0), cutArea_m2: 0 };

let url = "";
let token = "";
let view: Link | null = null;
let blade: Link | null = null;
let volume: Link | null = null; // while the page colours by the tetrahedra's quality
let colourByQuality = false;
let ownSource = -1;

// The state that the surface holds.
let session = 0n;
let revision = 0n;
let holding = false; // a whole state
let staged: SnapshotChunk[] | null = null;
let resyncing = false;
let replaying = false; // the statistics are of the live mesh
let bodySize_m = 1;

let capacity = 0; // slots that the page has room for
let waiting = false; // the page has a patch that it has not applied yet
let steps: BladeStep[] = [];
let openingCost_ms = 0;
let deforms = false;
let openingTimer: ReturnType<typeof setTimeout> | undefined;
const progress: Progress = {
  revision: 0, tets: 0, triangles: 0, pieces: 1, hash: "", hashAgrees: true, deltas: 0, bytes: 0,
  posed_ms: 0, arrived_ms: 0,
};

function post(message: FromWorker, transfer: Transferable[] = []): void {
  postMessage(message, { transfer });
}

const vec = (v: WireVec3 | null): Vec3 => (v ? [v.x(), v.y(), v.z()] : [0, 0, 0]);

// ---- Out: to the page ----

function corners(slots: Uint32Array | null, count: number): Corners {
  const out = allocateCorners(count);
  for (let i = 0; i < count; ++i) builder.write(slots ? slots[i] : i, out, i);
  return out;
}

function transferable(c: Corners): Transferable[] {
  return [c.positions.buffer, c.normals.buffer, c.facts.buffer];
}

function postAll(): void {
  builder.measureAll();
  capacity = Math.ceil(surface.slots * 1.4) + 4096;
  const all = corners(null, surface.slots);
  surface.clearTouched();
  steps = [];
  post({ kind: "geometry", slots: surface.slots, capacity, corners: all, progress: { ...progress } }, transferable(all));
  scheduleOpening(0);
}

/** What has changed, unless the page still has the last such on its hands: then it waits and grows by what comes. */
function postChanges(): void {
  if (!holding || waiting) return;
  if (surface.slots > capacity) return postAll();
  if (surface.touchedSlots.size === 0 && surface.touchedVertices.size === 0 && steps.length === 0) return;
  const slots = builder.touched();
  const changed = corners(slots, slots.length);
  surface.clearTouched();
  waiting = true;
  post({ kind: "patch", slots, highest: surface.slots, corners: changed, rows: builder.rowCount, steps, progress: { ...progress } },
       [slots.buffer, ...transferable(changed)]);
  steps = [];
  scheduleOpening(Math.max(kOpeningPause_ms, 8 * openingCost_ms)); // of a large body it must not eat up the worker
}

function scheduleOpening(pause_ms: number): void {
  openingTimer ??= setTimeout(() => {
    openingTimer = undefined;
    if (!holding) return;
    const began_ms = performance.now();
    computeOpening(surface, (piece) => builder.rowOf(piece), builder.rowCount, bodySize_m, opening);
    const lips = new Float32Array(9 * surface.slots);
    for (let c = 0; c < 3 * surface.slots; ++c) {
      if (surface.ids[(c / 3) | 0] === kNone) continue;
      const v = 3 * surface.corners[c];
      lips[3 * c] = opening.lips[v];
      lips[3 * c + 1] = opening.lips[v + 1];
      lips[3 * c + 2] = opening.lips[v + 2];
    }
    const pieces = opening.pieces.slice(0, 4 * builder.rowCount);
    post({ kind: "opening", lips, pieces, cutArea_m2: opening.cutArea_m2 }, [lips.buffer, pieces.buffer]);
    openingCost_ms = performance.now() - began_ms;
  }, pause_ms);
}

// ---- In: the state ----

function onWelcome(welcome: Welcome): void {
  const facts = welcome.mesh();
  const box = facts?.box();
  const min = vec(box?.min() ?? null), max = vec(box?.max() ?? null);
  bodySize_m = Math.hypot(max[0] - min[0], max[1] - min[1], max[2] - min[2]) || 1;
  builder.grainCells = 55 / bodySize_m;
  staged = null;
  resyncing = false;
  if (welcome.session() !== session) holding = false;
  progress.tets = welcome.revision() === 0n ? (facts?.tets() ?? 0) : 0;
  session = welcome.session();
  post({
    kind: "facts",
    facts: {
      session: hex(session), meshName: facts?.name() ?? "", tets: facts?.tets() ?? 0, vertices: facts?.vertices() ?? 0,
      meanEdge_m: facts?.meanEdgeLengthM() ?? 0, min, max, policy: welcome.policy() ?? "",
      server: `${welcome.serverName()} ${welcome.serverVersion()}`, frameRate_hz: welcome.frameRateHz(),
    },
  });
}

function onSnapshotEnd(end: SnapshotEnd): void {
  if (!staged) return;
  surface.clear();
  builder.restart();
  let good = true;
  for (const chunk of staged) good = surface.setVertices(chunk.surfaceVertices()) && surface.setTriangles(chunk.triangles()) && good;
  staged = null;
  resyncing = false;
  holding = true;
  revision = end.revision();
  check(good, end.surfaceHash(), end.stateHash());
  progress.posed_ms = 0;
  countRows();
  postAll();
}

function countRows(): void {
  for (let s = 0; s < surface.slots; ++s) builder.rowOf(surface.pieces[s]);
}

function onDelta(delta: SurfaceDelta): void {
  if (!holding || resyncing || staged) return;
  if (delta.baseRevision() !== revision) return resync("the delta does not follow on the state");
  const good = surface.setVertices(delta.vertices()) && surface.setTriangles(delta.triangles());
  surface.removeTriangles(delta.removedTrianglesArray());
  surface.removeVertices(delta.removedVerticesArray());
  revision = delta.revision();
  progress.tets = delta.liveTets();
  ++progress.deltas;
  for (let i = 0; i < delta.stepsLength(); ++i) {
    const step = delta.steps(i)!;
    if (step.stroke() === 0) {
      if (!deforms) post({ kind: "deforms" });
      deforms = true;
      continue;
    }
    const own = step.source() === ownSource && blade?.open === true;
    // In a replay nobody posed.
    progress.posed_ms = replaying ? 0 : Number((own ? step.toSourceNs() : step.arrivalNs() - (view?.clockOffset_ns ?? 0n)) / 1000n) / 1e3;
    steps.push({ source: step.source(), own, heel: vec(step.toHeel()), tip: vec(step.toTip()), ended: step.strokeEnded() });
  }
  if (steps.length > 256) steps.splice(0, steps.length - 256); // of a page that does not look
  check(good, delta.surfaceHash(), delta.stateHash());
}

/** What the server says this state hashes to, against what it hashes to here. */
function check(good: boolean, surfaceHash: bigint, stateHash: bigint): void {
  const agrees = good && surfaceHash === surface.surfaceHash;
  progress.revision = Number(revision);
  progress.triangles = surface.triangleCount;
  progress.pieces = surface.pieceCount;
  progress.hash = hex(stateHash);
  progress.hashAgrees = agrees;
  progress.arrived_ms = performance.timeOrigin + performance.now();
  if (!agrees) resync(good ? "the surface hash differs" : "the arrays do not fit the state");
}

function resync(reason: string): void {
  resyncing = true;
  view?.send(Body.Resync, (b) => Resync.createResync(b, revision, surface.surfaceHash, b.createString(reason)));
}

function onViewMessage(type: Body, message: Message, bytes: number): void {
  progress.bytes += bytes;
  switch (type) {
    case Body.SnapshotBegin: {
      const begin: SnapshotBegin = message.body(new SnapshotBegin());
      staged = begin.view() === View.Surface ? [] : null;
      break;
    }
    case Body.SnapshotChunk:
      staged?.push(message.body(new SnapshotChunk()));
      break;
    case Body.SnapshotEnd:
      onSnapshotEnd(message.body(new SnapshotEnd()));
      break;
    case Body.SurfaceDelta:
      onDelta(message.body(new SurfaceDelta()));
      postChanges();
      break;
    case Body.BladePose: {
      const pose: BladePose = message.body(new BladePose());
      if (pose.source() === ownSource && blade?.open) break; // the page knows that one first
      post({ kind: "blade-pose", source: pose.source(), heel: vec(pose.heel()), tip: vec(pose.tip()), cutting: pose.cutting() });
      break;
    }
    case Body.Stats: {
      const stats: Stats = message.body(new Stats());
      if (!replaying && stats.revision() === revision) progress.tets = stats.liveTets();
      post({ kind: "stats", json: stats.json() ?? "{}", roundTrip_ms: view?.roundTrip_ms ?? 0, tets: progress.tets });
      break;
    }
    case Body.ReplayState: {
      const state: ReplayState = message.body(new ReplayState());
      replaying = Boolean(state.capture());
      followElements();
      post({
        kind: "replay",
        facts: state.capture() ? {
          capture: state.capture() ?? "", playing: state.playing(), speed: state.speed(), revision: Number(state.revision()),
          lastRevision: Number(state.lastRevision()), text: state.text() ?? "",
        } : null,
      });
      break;
    }
  }
}

// ---- The links ----

function openView(): void {
  view?.end();
  view = new Link(url, {
    hello: (): HelloFields => ({
      role: Role.Viewer, view: View.Surface, token, bladeRate_hz: 60,
      resumeSession: holding ? session : 0n, resumeRevision: holding ? revision : 0n,
    }),
    welcome: onWelcome,
    message: onViewMessage,
    state: (state) => post({ kind: "link", which: "view", state }),
    refused: (text) => post({ kind: "notice", text }),
    unreadable: () => (holding = false), // whatever it did to the state
  });
}

/** The mouse's blade has a connection of its own: whether somebody may watch does not depend on whether he may cut. */
function takeBlade(takeOver: boolean, length_m: number): void {
  blade?.end();
  blade = new Link(url, {
    hello: () => ({ role: Role.Operator, view: View.None, token, sourceName: "mouse", takeOver, blade: { heel: [0, 0, 0], tip: [0, 0, -length_m] } }),
    welcome: (welcome) => {
      ownSource = welcome.source();
      takeOver = true; // after a lost connection the server may not know yet that we are gone
      post({
        kind: "blade",
        facts: {
          heel: vec(welcome.bladeHeel()), tip: vec(welcome.bladeTip()), source: ownSource,
          engageButton: welcome.engageButton(), maxSpeed_m_s: welcome.maxSpeedMS(),
        },
      });
    },
    message: () => {},
    state: (state: LinkState) => {
      if (state.stage === "ended") blade = null;
      post({ kind: "link", which: "blade", state });
    },
    refused: (text) => post({ kind: "notice", text }),
    unreadable: () => {},
  });
}

/** Colours by quality need the tetrahedra. A replay's are not to be had: it is this one link's own. */
function followElements(): void {
  const wanted = colourByQuality && !replaying;
  if (wanted === (volume !== null)) return;
  builder.elements = null;
  volume?.end();
  volume = null;
  if (!wanted) {
    builder.touchByQuality();
    postChanges();
    return;
  }
  const elements = new Elements();
  let at = 0n;
  volume = new Link(url, {
    hello: () => ({ role: Role.Viewer, view: View.Volume, token, maxRate_hz: kElementsRate_hz }),
    welcome: () => (builder.elements = null),
    message: (type, message) => {
      switch (type) {
        case Body.SnapshotBegin:
          builder.elements = null;
          elements.clear();
          return;
        case Body.SnapshotChunk:
          return elements.addChunk(message.body(new SnapshotChunk()));
        case Body.SnapshotEnd:
          at = message.body(new SnapshotEnd()).revision();
          builder.elements = elements;
          break;
        case Body.Delta: {
          const delta: Delta = message.body(new Delta());
          if (!builder.elements) return; // a snapshot is on its way
          if (delta.baseRevision() !== at) {
            builder.elements = null;
            volume?.send(Body.Resync, (b) => Resync.createResync(b, at, 0n, b.createString("the delta does not follow on the state")));
            return;
          }
          elements.apply(delta);
          at = delta.revision();
          break;
        }
        default:
          return;
      }
      builder.touchByQuality();
      postChanges();
    },
    state: () => {}, // the view's link says it all
    refused: (text) => post({ kind: "notice", text }),
    unreadable: () => (builder.elements = null),
  });
}

/** One errand: an administrator comes, resets, and goes. */
function reset(): void {
  let asked = false;
  const admin: Link = new Link(url, {
    hello: () => ({ role: Role.Admin, view: View.None, token }),
    welcome: () => {
      // The second Welcome is the reset's.
      if (asked) return admin.end();
      asked = true;
      admin.send(Body.Reset, (b) => Reset.createReset(b));
      setTimeout(() => admin.end(), 5000); // a server that does not offer it has said so by then
    },
    message: () => {},
    state: (state) => {
      if (state.stage === "waiting") admin.end();
      if (state.stage !== "open") post({ kind: "link", which: "admin", state });
    },
    refused: (text) => post({ kind: "notice", text }),
    unreadable: () => {},
  });
}

function sendPoses(poses: Float64Array): void {
  const count = poses.length / kNumbersPerPose;
  blade?.send(Body.PoseBatch, (b) => {
    PoseBatch.startPosesVector(b, count);
    for (let i = count - 1; i >= 0; --i) {
      const at = kNumbersPerPose * i;
      const time_ns = BigInt(Math.round(poses[at] * 1e3)) * 1000n;
      PoseSample.createPoseSample(b, time_ns, poses[at + 1], poses[at + 2], poses[at + 3], poses[at + 4], poses[at + 5],
                                  poses[at + 6], poses[at + 7], poses[at + 8], 0);
    }
    return PoseBatch.createPoseBatch(b, b.endVector());
  });
}

const kReplayActions = {
  open: ReplayAction.Open, play: ReplayAction.Play, pause: ReplayAction.Pause, step: ReplayAction.Step,
  seek: ReplayAction.Seek, close: ReplayAction.Close,
};

function dump(): void {
  const triangles = new Float32Array(9 * surface.triangleCount);
  let at = 0;
  for (let s = 0; s < surface.slots; ++s) {
    if (surface.ids[s] === kNone) continue;
    for (let k = 0; k < 3; ++k, at += 3) {
      const v = 3 * surface.corners[3 * s + k];
      triangles.set(surface.positions.subarray(v, v + 3), at);
    }
  }
  post({ kind: "dump", triangles });
}

onmessage = ({ data }: MessageEvent<ToWorker>) => {
  switch (data.kind) {
    case "connect":
      url = data.url;
      token = data.token;
      openView();
      break;
    case "take-blade":
      takeBlade(data.takeOver, data.length_m);
      break;
    case "release-blade":
      blade?.end();
      blade = null;
      break;
    case "poses":
      sendPoses(data.poses);
      break;
    case "end-stroke":
      blade?.send(Body.StrokeControl, (b) => StrokeControl.createStrokeControl(b, StrokeAction.End, now_ns()));
      break;
    case "reset":
      reset();
      break;
    case "colour-by-quality":
      colourByQuality = data.on;
      followElements();
      break;
    case "replay":
      view?.send(Body.ReplayControl, (b) =>
        ReplayControl.createReplayControl(b, kReplayActions[data.action], b.createString(data.capture ?? ""),
                                          data.speed ?? 1, BigInt(data.revision ?? 0)));
      break;
    case "applied":
      waiting = false;
      postChanges();
      break;
    case "wake":
      view?.wake();
      blade?.wake();
      break;
    case "drop":
      view?.drop();
      break;
    case "dump":
      dump();
      break;
  }
};
