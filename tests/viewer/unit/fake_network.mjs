// A network and a clock that do what a test says, and messages as a server sends them.

import { load } from "./modules.mjs";

const wire = (name) => `wire/incise/wire/${name}`;
export const { Body, Builder, ByteBuffer, Bye, ByeReason, ErrorCode, Message, Pong, Welcome } = await load(
  wire("body"),
  "../node_modules/flatbuffers",
  wire("bye"),
  wire("bye-reason"),
  wire("error-code"),
  wire("message"),
  wire("pong"),
  wire("welcome"),
);
const { Error: WireError } = await load(wire("error"));
const { Restart } = await load(wire("restart"));

// ---- The network and the clock ----

export const sockets = [];
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
globalThis.fetch = () => Promise.reject(new Error("there is no HTTP here")); // as of a server that has no more to say

/** setInterval and setTimeout by hand: `run` calls what is due in so many milliseconds. */
const clock = { now: 0, timers: new Map(), next: 1 };
function add(callback, ms, every) {
  clock.timers.set(clock.next, { callback, due: clock.now + ms, every });
  return clock.next++;
}
globalThis.setTimeout = (callback, ms = 0) => add(callback, ms, 0);
globalThis.setInterval = (callback, ms) => add(callback, ms, ms);
globalThis.clearTimeout = globalThis.clearInterval = (id) => clock.timers.delete(id);
export function run(ms) {
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

/** Forgets all connections and timers. */
export function forget() {
  sockets.length = 0;
  clock.timers.clear();
}

// ---- Messages ----

export function message(type, make) {
  const b = new Builder(256);
  const body = make(b);
  Message.startMessage(b);
  Message.addBodyType(b, type);
  Message.addBody(b, body);
  Message.finishMessageBuffer(b, Message.endMessage(b));
  return b.asUint8Array();
}
/** `restart`: [kind, role, by, others] of who has made these ids start again. */
export const welcome = (session = 1n, restart = null) =>
  message(Body.Welcome, (b) => {
    const others = restart && Restart.createOthersVector(b, (restart[3] ?? []).map((name) => b.createString(name)));
    const began = restart && Restart.createRestart(b, restart[0], restart[1], b.createString(restart[2]), 0, 0, others);
    Welcome.startWelcome(b);
    Welcome.addSession(b, session);
    if (began) Welcome.addRestart(b, began);
    return Welcome.endWelcome(b);
  });
export const pong = () => message(Body.Pong, (b) => Pong.createPong(b, 1n, 0n, 0n));
export const bye = (reason) => message(Body.Bye, (b) => Bye.createBye(b, reason, 0));
export const error = (code, fatal) =>
  message(Body.Error, (b) => {
    const text = b.createString("because");
    WireError.startError(b);
    WireError.addCode(b, code);
    WireError.addFatal(b, fatal);
    WireError.addText(b, text);
    return WireError.endError(b);
  });
export const sentKinds = (socket) =>
  socket.sent.map((bytes) => Message.getRootAsMessage(new ByteBuffer(bytes)).bodyType());
