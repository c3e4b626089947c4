// The worker's side of the stream: a link and what it says of the server, the viewer, the page's feed.

import assert from "node:assert/strict";
import { test } from "node:test";
import { fill, load, surfaceStream } from "./modules.mjs";

// ---- A network and a clock that do what a test says ----

const sockets = [];
class FakeSocket {
  static OPEN = 1;
  readyState = 0;
  sent = [];
  constructor(url) {
    this.url = url;
    sockets.push(this);
  }
  open() {
    this.readyState = FakeSocket.OPEN;
    this.onopen();
  }
  send(bytes) {
    this.sent.push(Uint8Array.from(bytes));
  }
  receive(bytes) {
    this.onmessage({ data: Uint8Array.from(bytes).buffer });
  }
  close() {
    this.readyState = 3;
  }
}
globalThis.WebSocket = FakeSocket;

/** setInterval and setTimeout by hand: `run` calls what is due in so many milliseconds. */
const clock = { now: 0, timers: new Map(), next: 1 };
function add(callback, ms, every) {
  clock.timers.set(clock.next, { callback, due: clock.now + ms, every });
  return clock.next++;
}
globalThis.setTimeout = (callback, ms = 0) => add(callback, ms, 0);
globalThis.setInterval = (callback, ms) => add(callback, ms, ms);
globalThis.clearTimeout = globalThis.clearInterval = (id) => clock.timers.delete(id);
function run(ms) {
  const end = clock.now + ms;
  for (;;) {
    const [id, timer] = [...clock.timers].filter(([, t]) => t.due <= end).sort((a, b) => a[1].due - b[1].due)[0] ?? [];
    if (!timer) break;
    clock.now = timer.due;
    if (timer.every) timer.due += timer.every;
    else clock.timers.delete(id);
    timer.callback();
  }
  clock.now = end;
}

const {
  Link,
  Viewer,
  PageFeed,
  Surface,
  Blade,
  Message,
  Body,
  Builder,
  ByteBuffer,
  Pong,
  Bye,
  ByeReason,
  WireError,
  ErrorCode,
  Welcome,
  Hello,
  PoseBatch,
  SurfaceDelta,
  BladeEdge,
} = await load(
  "link",
  "viewer",
  "page_feed",
  "surface",
  "blade",
  "wire/incise/wire/message",
  "wire/incise/wire/body",
  "../node_modules/flatbuffers",
  "wire/incise/wire/pong",
  "wire/incise/wire/bye",
  "wire/incise/wire/bye-reason",
  "wire/incise/wire/error-code",
  "wire/incise/wire/welcome",
  "wire/incise/wire/hello",
  "wire/incise/wire/surface-delta",
  "wire/incise/wire/pose-batch",
  "wire/incise/wire/blade-edge",
).then(async (all) => ({
  ...all,
  WireError: (await load("wire/incise/wire/error")).Error,
}));

function message(type, make) {
  const b = new Builder(256);
  const body = make(b);
  Message.startMessage(b);
  Message.addBodyType(b, type);
  Message.addBody(b, body);
  Message.finishMessageBuffer(b, Message.endMessage(b));
  return b.asUint8Array();
}
const welcome = (session = 1n) =>
  message(Body.Welcome, (b) => {
    Welcome.startWelcome(b);
    Welcome.addSession(b, session);
    return Welcome.endWelcome(b);
  });
const pong = () => message(Body.Pong, (b) => Pong.createPong(b, 1n, 0n, 0n));
const bye = (reason) => message(Body.Bye, (b) => Bye.createBye(b, reason, 0));
const error = (code, fatal) =>
  message(Body.Error, (b) => {
    const text = b.createString("because");
    WireError.startError(b);
    WireError.addCode(b, code);
    WireError.addFatal(b, fatal);
    WireError.addText(b, text);
    return WireError.endError(b);
  });
const sentKinds = (socket) => socket.sent.map((bytes) => Message.getRootAsMessage(new ByteBuffer(bytes)).bodyType());

function open() {
  sockets.length = 0;
  clock.timers.clear();
  const states = [],
    refused = [];
  const link = new Link("ws://here", {
    hello: () => ({ role: 0, view: 0, token: "t" }),
    welcome: () => {},
    message: () => {},
    unreadable: () => {},
    state: (state) => states.push(state),
    refused: (text) => refused.push(text),
  });
  sockets[0].open();
  sockets[0].receive(welcome());
  return { link, states, refused, stages: () => states.map((s) => s.stage) };
}

test("a link whose server answers stays open", () => {
  const { stages } = open();
  for (let i = 0; i < 100; ++i) {
    run(400);
    sockets[0].receive(pong());
  }
  assert.deepEqual(stages(), ["connecting", "open"]);
  assert.ok(sentKinds(sockets[0]).filter((kind) => kind === Body.Ping).length >= 100);
});

test("a server that does not answer is seen at the third check, gets no more pings, and is left after the twenty-second", () => {
  const { stages, states } = open();
  sockets[0].receive(pong());
  run(2 * 400);
  assert.deepEqual(stages(), ["connecting", "open"]);
  run(400);
  assert.deepEqual(stages(), ["connecting", "open", "stalled"]);
  run(18 * 400);
  assert.equal(stages().at(-1), "stalled");
  const pings = sentKinds(sockets[0]).filter((kind) => kind === Body.Ping).length;
  assert.equal(pings, 2); // the one with the Welcome, which was answered, and one that is not
  run(400);
  assert.equal(stages().at(-1), "waiting");
  assert.match(states.at(-1).text, /Nothing was heard|lost/);
  run(1000);
  assert.equal(sockets.length, 2); // it tries again
});

test("whatever comes ends the stall, on the same connection", () => {
  const { stages } = open();
  run(5 * 400);
  assert.equal(stages().at(-1), "stalled");
  sockets[0].receive(pong());
  assert.equal(stages().at(-1), "open");
  run(2 * 400);
  assert.equal(stages().at(-1), "open");
  assert.equal(sockets.length, 1);
});

test("a connection that is never welcomed is left, too", () => {
  sockets.length = 0;
  clock.timers.clear();
  const states = [];
  new Link("ws://here", { hello: () => ({ role: 0, view: 0, token: "" }), state: (s) => states.push(s.stage) });
  run(21 * 400);
  assert.deepEqual(states, ["connecting"]);
  run(400);
  assert.deepEqual(states, ["connecting", "waiting"]);
});

test("each way to be sent away is told apart", () => {
  const cases = [
    [error(ErrorCode.Unauthorized, true), "ended", "token"],
    [error(ErrorCode.BladeTaken, true), "ended", "taken"],
    [error(ErrorCode.BadVersion, true), "ended", "version"],
    [bye(ByeReason.HandedOver), "ended", "handed-over"],
  ];
  for (const [bytes, stage, reason] of cases) {
    const { states } = open();
    sockets[0].receive(bytes);
    assert.deepEqual([states.at(-1).stage, states.at(-1).reason], [stage, reason]);
    run(60_000);
    assert.equal(sockets.length, 1, `${reason}: it does not come back`);
  }
  const { refused, states } = open();
  sockets[0].receive(error(ErrorCode.Forbidden, false));
  assert.deepEqual(refused, ["because"]);
  assert.equal(states.at(-1).stage, "open");
  sockets[0].receive(bye(ByeReason.ServerStops));
  sockets[0].onclose();
  assert.match(states.at(-1).text, /The server has stopped/);
});

test("bytes that are not a message end the connection, which comes back", () => {
  const { stages } = open();
  sockets[0].receive(new Uint8Array(40));
  assert.equal(stages().at(-1), "waiting");
  run(1000);
  assert.equal(sockets.length, 2);
});

test("each pause before a try is longer, up to a bound", () => {
  open();
  sockets[0].onclose();
  const tries = [];
  for (let ms = 0; ms < 60_000; ms += 50) {
    const before = sockets.length;
    run(50);
    if (sockets.length > before) {
      tries.push(ms);
      sockets.at(-1).onclose();
    }
  }
  const pauses = tries.slice(1).map((t, i) => t - tries[i]);
  assert.ok(pauses[0] < 1000);
  assert.ok(pauses.at(-1) > 5000 && Math.max(...pauses) < 10_500, pauses.join());
});

// ---- The viewer ----

function view(blade = { owns: () => false }) {
  sockets.length = 0;
  clock.timers.clear();
  const said = [];
  const viewer = new Viewer(blade, (m) => said.push(m));
  viewer.connect("ws://here", "");
  sockets[0].open();
  return { viewer, said, kinds: () => said.map((m) => m.kind) };
}

test("another session on the same connection is a reset, on a new one it is not", () => {
  const { said, viewer, kinds } = view();
  sockets[0].receive(welcome(1n));
  sockets[0].receive(welcome(2n));
  assert.equal(kinds().filter((kind) => kind === "was-reset").length, 1);
  sockets[0].onclose();
  run(1000);
  sockets[1].open();
  sockets[1].receive(welcome(3n)); // the server was started again
  assert.equal(kinds().filter((kind) => kind === "was-reset").length, 1);
  // A replay has a session of its own.
  viewer.controlReplay({ kind: "replay", action: "open", capture: "a.capture" });
  sockets[1].receive(welcome(4n));
  sockets[1].receive(welcome(3n));
  assert.equal(said.filter((m) => m.kind === "was-reset").length, 1);
});

test("the viewer shows the protocol's example to the page", () => {
  const { said } = view();
  const messages = surfaceStream();
  for (const bytes of messages) {
    sockets[0].receive(bytes);
    said.push({ kind: "read" });
  }
  const geometry = said.find((m) => m.kind === "geometry");
  assert.equal(geometry.progress.hashAgrees, true);
  assert.ok(geometry.slots > 0);
  const patch = said.find((m) => m.kind === "patch");
  assert.equal(patch.progress.revision, 1);
  assert.equal(patch.progress.deltas, 1);
  assert.equal(patch.progress.hashAgrees, true);
});

test("a connection that is lost is taken up with the state that is held, and its hash", () => {
  view();
  const helloOf = (socket) => Message.getRootAsMessage(new ByteBuffer(socket.sent[0])).body(new Hello());
  assert.equal(helloOf(sockets[0]).resumeHash(), 0n);
  let last;
  for (const bytes of surfaceStream()) {
    const message = Message.getRootAsMessage(new ByteBuffer(bytes));
    if (message.bodyType() === Body.Bye) break;
    if (message.bodyType() === Body.SurfaceDelta) last = message.body(new SurfaceDelta());
    sockets[0].receive(bytes);
  }
  sockets[0].onclose();
  run(1000);
  sockets[1].open();
  const hello = helloOf(sockets[1]);
  assert.equal(hello.resumeRevision(), last.revision());
  assert.equal(hello.resumeHash(), last.stateHash());
});

/** What the page is sent of the protocol's example, whose two steps are of source 2. */
function shown({ own = false, replaying = false, offset_ns = 0n, spoil = () => {} } = {}) {
  const { viewer, said } = view({ owns: (source) => own && source === 2 });
  for (const bytes of surfaceStream()) {
    const message = Message.getRootAsMessage(new ByteBuffer(bytes));
    if (message.bodyType() === Body.SurfaceDelta) spoil(message.body(new SurfaceDelta()));
    sockets[0].receive(bytes);
    viewer.replaying = replaying;
    viewer.link.clockOffset_ns = offset_ns;
  }
  const patch = said.find((m) => m.kind === "patch");
  return { said, patch, step: patch?.steps[0] };
}

test("a step is passed on with its area, and as one's own where it is", () => {
  const { step } = shown();
  assert.deepEqual([step.source, step.own, step.ended], [2, false, false]);
  assert.ok(step.cutArea_m2 > 8e-5);
  assert.equal(shown({ own: true }).step.own, true);
  assert.equal(shown({ own: true, replaying: true }).step.own, false);
});

test("a pose is as old as its arrival says, one's own as its own clock says, where that is earlier", () => {
  assert.equal(shown().patch.posed_ms, 77_000);
  assert.equal(shown({ offset_ns: 70_000_000_000n }).patch.posed_ms, 7000);
  assert.equal(shown({ own: true }).patch.posed_ms, 1004);
  assert.equal(shown({ own: true, offset_ns: 76_500_000_000n }).patch.posed_ms, 500);
  assert.equal(shown({ replaying: true }).patch.posed_ms, 0);
});

test("a step without a stroke is a simulation's, and is said once", () => {
  const { said, patch } = shown({
    spoil: (delta) => {
      if (delta.revision() !== 1n) return;
      const step = delta.steps(0);
      step.bb.writeInt32(step.bb_pos + step.bb.__offset(step.bb_pos, 8), 0);
    },
  });
  assert.equal(said.filter((m) => m.kind === "deforms").length, 1);
  assert.deepEqual(patch.steps, []);
  assert.equal(patch.posed_ms, 0);
});

test("a state that differs is said to, and asked for again", () => {
  const { said } = shown({ spoil: (delta) => (delta.vertices().positionsArray()[0] += 1) });
  assert.equal(said.filter((m) => m.kind === "differs").length, 1);
  assert.ok(sentKinds(sockets[0]).includes(Body.Resync));
  assert.equal(shown().said.filter((m) => m.kind === "differs").length, 0);
});

test("a replay ends with its connection", () => {
  const { viewer, said } = view();
  sockets[0].receive(welcome());
  viewer.replaying = true;
  sockets[0].onclose();
  run(1000);
  sockets[1].open();
  assert.equal(viewer.replaying, false);
  assert.equal(said.filter((m) => m.kind === "replay").at(-1).facts, null);
});

// ---- The feed ----

const step = (n) => ({ source: 1, own: false, heel: [0, 0, 0], tip: [0, 0, n], ended: false, cutArea_m2: 0 });

function feed() {
  clock.timers.clear();
  const surface = fill(
    new Surface(),
    [
      [0, 0, 0],
      [1, 0, 0],
      [0, 1, 0],
    ],
    [{ v: [0, 1, 2] }],
  );
  const said = [];
  const pageFeed = new PageFeed(
    surface,
    () => ({}),
    (m) => said.push(m),
  );
  return { surface, said, pageFeed };
}

test("the page gets one patch at a time, and what came meanwhile in the next", () => {
  const { pageFeed, said } = feed();
  pageFeed.addStep(step(0), 1);
  pageFeed.sendChanges();
  assert.deepEqual(said, []); // the page has no state yet
  pageFeed.restart();
  pageFeed.sendChanges();
  assert.deepEqual(
    said.map((m) => m.kind),
    ["geometry"],
  ); // nothing has changed since
  for (let n = 1; n < 4; ++n) {
    pageFeed.addStep(step(n), 10 * n);
    pageFeed.sendChanges();
  }
  assert.deepEqual(
    said.map((m) => m.kind),
    ["geometry", "patch"],
  );
  pageFeed.applied();
  assert.deepEqual(
    said[2].steps.map((s) => s.tip[2]),
    [2, 3],
  );
  assert.equal(said[2].posed_ms, 30);
});

test("a patch that no pose is behind says so", () => {
  const { pageFeed, said, surface } = feed();
  pageFeed.restart();
  pageFeed.addStep(step(1), 77);
  pageFeed.sendChanges();
  pageFeed.applied();
  surface.touchedSlots.add(0); // other colours, or a simulation's positions
  pageFeed.sendChanges();
  assert.deepEqual(
    said.filter((m) => m.kind === "patch").map((m) => m.posed_ms),
    [77, 0],
  );
});

test("what waits for a page that is hidden stays bounded", () => {
  const { pageFeed, said } = feed();
  pageFeed.restart();
  pageFeed.addStep(step(0), 1);
  pageFeed.sendChanges();
  for (let n = 1; n <= 1000; ++n) pageFeed.addStep(step(n), n);
  pageFeed.applied();
  assert.equal(said.at(-1).steps.length, 256);
  assert.equal(said.at(-1).steps.at(-1).tip[2], 1000);
});

test("more triangles than there is room for are sent as a whole", () => {
  const { pageFeed, said, surface } = feed();
  pageFeed.restart();
  const { capacity } = said[0];
  const many = Array.from({ length: capacity + 1 }, (_, i) => ({ v: [3 * i, 3 * i + 1, 3 * i + 2], id: 4 * i }));
  fill(
    surface,
    many.flatMap((_, i) => [
      [i, 0, 0],
      [i + 1, 0, 0],
      [i, 1, 0],
    ]),
    many,
  );
  pageFeed.sendChanges();
  assert.equal(said.at(-1).kind, "geometry");
  assert.ok(said.at(-1).capacity > capacity);
});

// ---- The mouse's connection ----

test("a blade brings its length, owns its source while it is open, and sends poses as they are", () => {
  sockets.length = 0;
  clock.timers.clear();
  const said = [];
  const blade = new Blade((m) => said.push(m));
  blade.take("ws://here", "", false, 0.25);
  sockets[0].open();
  const hello = Message.getRootAsMessage(new ByteBuffer(sockets[0].sent[0])).body(new Hello());
  assert.equal(hello.sourceName(), "mouse");
  assert.equal(hello.blade(new BladeEdge()).tip().z(), -0.25);
  assert.equal(blade.owns(0), false);
  sockets[0].receive(welcome());
  assert.equal(blade.owns(0), true);
  blade.send(Float64Array.of(1000.5, 1, 2, 3, 1, 0, 0, 0, 1, 1001, 4, 5, 6, 0, 1, 0, 0, 0));
  const batch = Message.getRootAsMessage(new ByteBuffer(sockets[0].sent.at(-1))).body(new PoseBatch());
  assert.equal(batch.posesLength(), 2);
  assert.deepEqual([batch.poses(0).position().x(), batch.poses(1).position().z()], [1, 6]);
  assert.equal(batch.poses(0).sourceNs(), 1000_500_000n);
  assert.deepEqual([batch.poses(0).buttons(), batch.poses(1).buttons()], [1, 0]);
  blade.release();
  assert.equal(blade.owns(0), false);
});
