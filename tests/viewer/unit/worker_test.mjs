// The page's worker: which part gets which of the page's messages.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Body, ByteBuffer, Message, message, run, sentKinds, sockets, welcome } from "./fake_network.mjs";
import { load, surfaceStream } from "./modules.mjs";

const wire = (name) => `wire/incise/wire/${name}`;
const { Hello, ReplayState, Role, View } = await load(wire("hello"), wire("replay-state"), wire("role"), wire("view"));

const posted = [];
let toWorker = null;
globalThis.postMessage = (data) => posted.push(data);
globalThis.addEventListener = (name, listener) => {
  assert.equal(name, "message");
  toWorker = (data) => listener({ data });
};
await load("worker");

const hello = (socket) => Message.getRootAsMessage(new ByteBuffer(socket.sent[0])).body(new Hello());
const open = (socket) => {
  socket.open();
  return hello(socket);
};
const replayState = (capture) =>
  message(Body.ReplayState, (b) => {
    const name = b.createString(capture);
    ReplayState.startReplayState(b);
    ReplayState.addCapture(b, name);
    return ReplayState.endReplayState(b);
  });

test("each message of the page reaches its part", () => {
  toWorker({ kind: "connect", url: "ws://here", token: "secret" });
  const [view] = sockets;
  assert.equal(view.url, "ws://here");
  const greeting = open(view);
  assert.deepEqual([greeting.role(), greeting.view(), greeting.token()], [Role.Viewer, View.Surface, "secret"]);
  for (const bytes of surfaceStream().slice(0, -1)) view.receive(bytes);
  const patches = () => posted.filter((m) => m.kind === "patch").length;
  const before = patches();
  toWorker({ kind: "applied" });
  assert.equal(patches(), before + 1); // what came meanwhile
  toWorker({ kind: "dump" });
  assert.equal(posted.at(-1).kind, "dump");
  assert.ok(posted.at(-1).triangles.length > 0);

  // The blade: the same server and token, its own length.
  toWorker({ kind: "take-blade", takeOver: true, length_m: 0.25 });
  const blade = sockets.at(-1);
  const asks = open(blade);
  assert.deepEqual([asks.role(), asks.token(), asks.takeOver()], [Role.Operator, "secret", true]);
  blade.receive(welcome());
  toWorker({ kind: "poses", poses: Float64Array.of(1, 0, 0, 0, 1, 0, 0, 0, 1) });
  assert.equal(sentKinds(blade).at(-1), Body.PoseBatch);
  toWorker({ kind: "release-blade" });
  assert.equal(sentKinds(blade).at(-1), Body.Bye);

  toWorker({ kind: "reset" });
  assert.equal(open(sockets.at(-1)).role(), Role.Admin);

  toWorker({ kind: "replay", action: "open", capture: "a.capture" });
  assert.equal(sentKinds(view).at(-1), Body.ReplayControl);
});

test("the tetrahedra behind the colours are followed while they are wanted, and not in a replay", () => {
  const [view] = sockets;
  const count = sockets.length;
  toWorker({ kind: "colour-by-quality", on: true });
  assert.equal(sockets.length, count + 1);
  const elements = sockets.at(-1);
  assert.deepEqual([elements.url, open(elements).view()], ["ws://here", View.Volume]);
  view.receive(replayState("a.capture"));
  assert.equal(sentKinds(elements).at(-1), Body.Bye);
  assert.equal(sockets.length, count + 1);
  view.receive(replayState(""));
  assert.equal(sockets.length, count + 2);
  const again = sockets.at(-1);
  open(again);
  toWorker({ kind: "colour-by-quality", on: false });
  assert.equal(sentKinds(again).at(-1), Body.Bye);
});

test("a connection that is dropped comes back, at once where the page wakes up", () => {
  const count = sockets.length;
  toWorker({ kind: "drop" });
  assert.equal(sockets.length, count);
  toWorker({ kind: "wake" });
  assert.equal(sockets.length, count + 1);
  assert.equal(open(sockets.at(-1)).view(), View.Surface);
  run(0);
});
