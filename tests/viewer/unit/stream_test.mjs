// What the page's worker makes of the stream: the viewer, the page's feed, the mouse's connection.

import assert from "node:assert/strict";
import { test } from "node:test";
import {
  Body,
  ByteBuffer,
  ErrorCode,
  Message,
  error,
  forget,
  message,
  run,
  sentKinds,
  sockets,
  welcome,
} from "./fake_network.mjs";
import { fill, json, load, surfaceStream } from "./modules.mjs";

const wire = (name) => `wire/incise/wire/${name}`;
const { Viewer, PageFeed, Surface, Blade, ElementsLink, askAdmin, Hello, PoseBatch, SurfaceDelta, BladeEdge } =
  await load(
    "viewer",
    "page_feed",
    "surface",
    "blade",
    "elements_link",
    "reset",
    wire("hello"),
    wire("surface-delta"),
    wire("pose-batch"),
    wire("blade-edge"),
  );
const { Delta, ReplayAction, ReplayControl, Role, SnapshotBegin, SnapshotEnd, View } = await load(
  wire("delta"),
  wire("replay-action"),
  wire("replay-control"),
  wire("role"),
  wire("snapshot-begin"),
  wire("snapshot-end"),
  wire("view"),
);
const { BladePose, Stats, Vec3 } = await load(wire("blade-pose"), wire("mesh-facts"), wire("stats"), wire("vec3"));

// ---- The viewer ----

function view(blade = { owns: () => false }) {
  forget();
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

test("the page is told who has reset the body or undone a stroke", () => {
  const { said } = view();
  sockets[0].receive(welcome(1n));
  sockets[0].receive(welcome(2n, [1, Role.Admin, "ward 3"]));
  sockets[0].receive(welcome(3n, [2, Role.Operator, "left"]));
  sockets[0].receive(welcome(4n)); // an older server
  sockets[0].receive(welcome(5n, [2, Role.Operator, "left", ["right", "third"]]));
  const resets = said.filter((m) => m.kind === "was-reset");
  assert.deepEqual(
    resets.map((m) => m.by),
    ["administrator ward 3", "the operator of blade left", "", "the operator of blade left"],
  );
  assert.deepEqual(
    resets.map((m) => m.undone),
    [false, true, false, true], // whatever the revision
  );
  assert.deepEqual(resets[3].others, ["right", "third"]);
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

const hello = (socket) => Message.getRootAsMessage(new ByteBuffer(socket.sent[0])).body(new Hello());

test("a connection that comes back goes on from the state that is held, and from none that is not trusted", () => {
  view();
  const messages = surfaceStream();
  const deltas = messages.filter((m) => Message.getRootAsMessage(new ByteBuffer(m)).bodyType() === Body.SurfaceDelta);
  for (const bytes of messages.slice(0, messages.indexOf(deltas.at(-1)))) sockets[0].receive(bytes);
  const held = json("streams/surface.json").at(-2).revision;
  const back = () => {
    sockets.at(-1).onclose();
    run(1000);
    sockets.at(-1).open();
    return hello(sockets.at(-1));
  };
  assert.deepEqual([hello(sockets[0]).resumeSession(), hello(sockets[0]).resumeRevision()], [0n, 0n]);
  const again = back();
  assert.ok(again.resumeSession() !== 0n);
  assert.equal(Number(again.resumeRevision()), held);
  sockets.at(-1).receive(deltas.at(-1).subarray(0, 120)); // its arrays lie beyond its end
  run(1000);
  sockets.at(-1).open();
  assert.deepEqual([hello(sockets.at(-1)).resumeSession(), hello(sockets.at(-1)).resumeRevision()], [0n, 0n]);
});

test("while another session's state is on its way the page is sent nothing", () => {
  const { viewer, said } = view();
  for (const bytes of surfaceStream().slice(0, -1)) sockets[0].receive(bytes);
  sockets[0].receive(welcome(99n));
  viewer.feed.applied();
  viewer.feed.addStep(step(1), 1);
  said.length = 0;
  viewer.feed.sendChanges();
  run(10_000);
  assert.deepEqual(
    said.filter((m) => ["patch", "geometry", "opening"].includes(m.kind)),
    [],
  );
});

test("the body has the tetrahedra that its snapshot says", () => {
  const { viewer } = view();
  sockets[0].receive(welcome());
  sockets[0].receive(
    message(Body.SnapshotBegin, (b) => {
      SnapshotBegin.startSnapshotBegin(b);
      SnapshotBegin.addTetCount(b, 510);
      return SnapshotBegin.endSnapshotBegin(b);
    }),
  );
  sockets[0].receive(
    message(Body.Stats, (b) => {
      Stats.startStats(b);
      Stats.addLiveTets(b, 500); // of a session, not of the replay that one may be looking at
      return Stats.endStats(b);
    }),
  );
  assert.equal(viewer.progress().tets, 510);
});

test("other blades are shown, one's own is not: the page draws that itself", () => {
  const { said } = view({ owns: (source) => source === 2 });
  sockets[0].receive(welcome());
  for (const source of [2, 3]) {
    sockets[0].receive(
      message(Body.BladePose, (b) => {
        BladePose.startBladePose(b);
        BladePose.addSource(b, source);
        BladePose.addHeel(b, Vec3.createVec3(b, 1, 2, 3));
        BladePose.addTip(b, Vec3.createVec3(b, 4, 5, 6));
        return BladePose.endBladePose(b);
      }),
    );
  }
  const shownBlades = said.filter((m) => m.kind === "blade-pose");
  assert.deepEqual(
    shownBlades.map((m) => [m.source, m.heel]),
    [[3, [1, 2, 3]]],
  );
});

test("the force on a hand comes with its blade, one's own too, and once more when it has ended", () => {
  const { said } = view({ owns: (source) => source === 2 });
  sockets[0].receive(welcome());
  const blade = (source, force, cutting = false) =>
    sockets[0].receive(
      message(Body.BladePose, (b) => {
        BladePose.startBladePose(b);
        BladePose.addSource(b, source);
        BladePose.addHeel(b, Vec3.createVec3(b, 1, 2, 3));
        BladePose.addTip(b, Vec3.createVec3(b, 4, 5, 6));
        BladePose.addCutting(b, cutting);
        if (force) BladePose.addForceN(b, Vec3.createVec3(b, ...force));
        return BladePose.endBladePose(b);
      }),
    );
  blade(3, null);
  blade(3, [0, 0, 1.5]);
  blade(3, [0, 0, 1], true); // its tip is hidden in the tissue
  blade(2, [0.5, 0, 0], true);
  blade(3, null);
  blade(3, null);
  const forces = said.filter((m) => m.kind === "force").map((m) => m.force);
  assert.deepEqual(
    forces.map((f) => [f.source, f.newtons, f.at]),
    [
      [3, [0, 0, 1.5], [4, 5, 6]],
      [3, [0, 0, 1], [1, 2, 3]],
      [2, [0.5, 0, 0], [4, 5, 6]], // the heel of one's own is at the eye
      [3, [0, 0, 0], [4, 5, 6]],
    ],
  );
});

test("a replay that was refused leaves the next new session a reset", () => {
  const { viewer, kinds } = view();
  sockets[0].receive(welcome(1n));
  viewer.controlReplay({ kind: "replay", action: "open", capture: "none.capture" });
  sockets[0].receive(error(ErrorCode.BadRequest, false));
  sockets[0].receive(welcome(2n));
  assert.equal(kinds().filter((kind) => kind === "was-reset").length, 1);
});

test("what is asked of a replay is sent as asked, and the bytes of all messages are counted", () => {
  const { viewer, said } = view();
  let bytes = 0;
  for (const one of surfaceStream()) {
    const type = Message.getRootAsMessage(new ByteBuffer(one)).bodyType();
    if (type === Body.Bye) break;
    if (type !== Body.Welcome) bytes += one.length;
    sockets[0].receive(one);
  }
  viewer.feed.applied();
  assert.equal(said.filter((m) => m.kind === "patch").at(-1).progress.bytes, bytes);
  const asked = (wish) => {
    viewer.controlReplay({ kind: "replay", ...wish });
    const control = Message.getRootAsMessage(new ByteBuffer(sockets[0].sent.at(-1))).body(new ReplayControl());
    return [control.action(), control.capture(), control.speed(), control.revision()];
  };
  const { Open, Play, Pause, Step, Seek, Close } = ReplayAction;
  assert.deepEqual(asked({ action: "open", capture: "a.capture" }), [Open, "a.capture", 1, 0n]);
  assert.deepEqual(asked({ action: "play", speed: 4 }), [Play, "", 4, 0n]);
  assert.deepEqual(asked({ action: "pause" }), [Pause, "", 1, 0n]);
  assert.deepEqual(asked({ action: "step" }), [Step, "", 1, 0n]);
  assert.deepEqual(asked({ action: "seek", revision: 12 }), [Seek, "", 1, 12n]);
  assert.deepEqual(asked({ action: "close" }), [Close, "", 1, 0n]);
});

// ---- The connections beside it ----

test("a reset is asked for once, by an admin who leaves when it is done", () => {
  forget();
  const said = [];
  askAdmin("ws://here", "secret", "reset", (m) => said.push(m));
  sockets[0].open();
  assert.deepEqual([hello(sockets[0]).role(), hello(sockets[0]).token()], [Role.Admin, "secret"]);
  sockets[0].receive(welcome(1n));
  const resets = () => sentKinds(sockets[0]).filter((kind) => kind === Body.Reset).length;
  assert.equal(resets(), 1);
  sockets[0].receive(welcome(2n));
  assert.equal(resets(), 1);
  assert.equal(sentKinds(sockets[0]).at(-1), Body.Bye);
  run(60_000);
  assert.equal(sockets.length, 1);
});

test("without a blade of one's own an admin undoes", () => {
  forget();
  askAdmin("ws://here", "", "undo", () => {});
  sockets[0].open();
  sockets[0].receive(welcome(1n));
  const asked = sentKinds(sockets[0]);
  assert.equal(asked.filter((kind) => kind === Body.Undo).length, 1);
  assert.ok(!asked.includes(Body.Reset));
});

test("a reset is not tried again on another connection", () => {
  forget();
  const said = [];
  askAdmin("ws://here", "", "reset", (m) => said.push(m));
  sockets[0].onclose();
  run(60_000);
  assert.equal(sockets.length, 1);
  assert.equal(said.at(-1).state.stage, "waiting"); // so that the page can say that nothing was reset
});

test("the tetrahedra follow their deltas; one that does not fit is asked for again, and no colours are shown meanwhile", () => {
  forget();
  const builder = { elements: null, touchByQuality: () => {} };
  let changes = 0;
  const link = new ElementsLink(
    builder,
    () => ++changes,
    () => {},
  );
  link.follow(true, "ws://here", "secret");
  sockets[0].open();
  const greeting = hello(sockets[0]);
  assert.deepEqual([greeting.role(), greeting.view(), greeting.maxRateHz()], [Role.Viewer, View.Volume, 20]);
  sockets[0].receive(welcome());
  const snapshot = (revision) => {
    sockets[0].receive(
      message(Body.SnapshotBegin, (b) => {
        SnapshotBegin.startSnapshotBegin(b);
        return SnapshotBegin.endSnapshotBegin(b);
      }),
    );
    assert.equal(builder.elements, null);
    sockets[0].receive(
      message(Body.SnapshotEnd, (b) => {
        SnapshotEnd.startSnapshotEnd(b);
        SnapshotEnd.addRevision(b, revision);
        return SnapshotEnd.endSnapshotEnd(b);
      }),
    );
    assert.ok(builder.elements);
  };
  const delta = (base, revision) =>
    sockets[0].receive(
      message(Body.Delta, (b) => {
        Delta.startDelta(b);
        Delta.addBaseRevision(b, base);
        Delta.addRevision(b, revision);
        return Delta.endDelta(b);
      }),
    );
  const resyncs = () => sentKinds(sockets[0]).filter((kind) => kind === Body.Resync).length;
  snapshot(3n);
  delta(3n, 5n);
  delta(5n, 6n);
  assert.ok(builder.elements);
  assert.equal(changes, 3);
  for (const base of [5n, 7n]) {
    delta(base, 8n); // before or after what is held
    assert.equal(builder.elements, null);
    delta(8n, 9n); // sent before the server knew
    snapshot(6n);
  }
  assert.equal(resyncs(), 2);
  link.follow(false, "", "");
  assert.equal(builder.elements, null);
  assert.equal(sentKinds(sockets[0]).at(-1), Body.Bye);
});

// ---- The feed ----

const step = (n) => ({ source: 1, own: false, heel: [0, 0, 0], tip: [0, 0, n], ended: false, cutArea_m2: 0 });

function feed() {
  forget();
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

test("how the body opens is sent after its changes, and not while another session is awaited", () => {
  const { pageFeed, said } = feed();
  const openings = () => said.filter((m) => m.kind === "opening").length;
  pageFeed.restart();
  run(0);
  assert.equal(openings(), 1);
  const { lips, pieces } = said.find((m) => m.kind === "opening");
  assert.deepEqual([lips.length, pieces.length], [9, 4 * pageFeed.builder.rowCount]);
  pageFeed.addStep(step(1), 1);
  pageFeed.sendChanges();
  pageFeed.pause();
  run(10_000);
  assert.equal(openings(), 1);
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
  forget();
  const said = [];
  const blade = new Blade((m) => said.push(m));
  blade.take("ws://here", "", false, 0.25);
  sockets[0].open();
  assert.equal(hello(sockets[0]).sourceName(), "mouse");
  assert.equal(hello(sockets[0]).blade(new BladeEdge()).tip().z(), -0.25);
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

test("after a break the blade is taken from the connection that was lost", () => {
  forget();
  const blade = new Blade(() => {});
  blade.take("ws://here", "", false, 0.25);
  sockets[0].open();
  assert.equal(hello(sockets[0]).takeOver(), false);
  sockets[0].receive(welcome());
  sockets[0].onclose();
  run(1000);
  sockets[1].open();
  assert.equal(hello(sockets[1]).takeOver(), true);
});
