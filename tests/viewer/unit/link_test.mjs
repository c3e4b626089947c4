// A connection of the page's worker: when it is open, stalled or left, and when it comes back.

import assert from "node:assert/strict";
import { test } from "node:test";
import {
  Body,
  ByeReason,
  ErrorCode,
  ByteBuffer,
  Message,
  bye,
  error,
  forget,
  message,
  pong,
  Pong,
  run,
  sentKinds,
  sockets,
  welcome,
} from "./fake_network.mjs";
import { load } from "./modules.mjs";

const wire = (name) => `wire/incise/wire/${name}`;
const { Link, Hello, Ping, Role, View } = await load("link", wire("hello"), wire("ping"), wire("role"), wire("view"));

function open(events = {}) {
  forget();
  const states = [],
    refused = [];
  const link = new Link("ws://here", {
    hello: () => ({ role: 0, view: 0, token: "t" }),
    welcome: () => {},
    message: () => {},
    unreadable: () => {},
    state: (state) => states.push(state),
    refused: (text) => refused.push(text),
    ...events,
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

test("a greeting has all that was asked for, and a number of its own", () => {
  forget();
  const fields = { role: Role.Operator, view: View.None, token: "secret", sourceName: "mouse", takeOver: true };
  const rest = { bladeRate_hz: 60, maxRate_hz: 20, resumeSession: 7n, resumeRevision: 8n, resumeHash: 9n };
  const silent = { welcome() {}, message() {}, unreadable() {}, state() {}, refused() {} };
  const link = new Link("ws://here", { hello: () => ({ ...fields, ...rest }), ...silent });
  sockets[0].open();
  const sent = (i) => Message.getRootAsMessage(new ByteBuffer(sockets[0].sent[i]));
  assert.equal(sent(0).sequence(), 1n);
  const hello = sent(0).body(new Hello());
  assert.deepEqual([hello.protocolVersion(), hello.role(), hello.view()], [2, Role.Operator, View.None]);
  assert.deepEqual([hello.token(), hello.sourceName(), hello.takeOver()], ["secret", "mouse", true]);
  assert.deepEqual([hello.bladeRateHz(), hello.maxRateHz()], [60, 20]);
  assert.deepEqual([hello.resumeSession(), hello.resumeRevision(), hello.resumeHash()], [7n, 8n, 9n]);
  assert.equal(hello.blade(), null);
  sockets[0].receive(welcome());
  assert.equal(sent(1).sequence(), 2n);
  link.end();
});

test("a ping is answered with its own number and time", () => {
  open();
  sockets[0].receive(message(Body.Ping, (b) => Ping.createPing(b, 5n, 123_456n)));
  const answer = Message.getRootAsMessage(new ByteBuffer(sockets[0].sent.at(-1)));
  assert.equal(answer.bodyType(), Body.Pong);
  const pong = answer.body(new Pong());
  assert.deepEqual([pong.nonce(), pong.pingSentNs()], [5n, 123_456n]);
  assert.ok(pong.receivedNs() > 123_456n);
});

test("why one connection was lost is not said of the next", () => {
  const { states } = open();
  sockets[0].receive(bye(ByeReason.ServerStops));
  sockets[0].onclose();
  assert.match(states.at(-1).text, /The server has stopped/);
  run(1000);
  sockets[1].open();
  sockets[1].receive(welcome());
  sockets[1].onclose();
  assert.match(states.at(-1).text, /The connection was lost/);
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
  forget();
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
  assert.equal(states.at(-1).stage, "waiting");
});

test("bytes that are not a message end the connection, which comes back", () => {
  const { stages } = open();
  sockets[0].receive(new Uint8Array(40));
  assert.equal(stages().at(-1), "waiting");
  run(1000);
  assert.equal(sockets.length, 2);
});

test("a message that is too short to be one ends the connection, which is not the state's fault", () => {
  const read = [];
  const { stages } = open({ message: (type) => read.push(type), unreadable: () => read.push("unreadable") });
  sockets[0].receive(Uint8Array.of(8, 0, 0, 0, ...Buffer.from("INC1"), 0, 0, 0, 0));
  assert.deepEqual([stages().at(-1), read], ["waiting", []]);
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

test("a link that was ended does not come back when its socket closes", () => {
  const { link, stages } = open();
  link.end();
  assert.equal(sentKinds(sockets[0]).at(-1), Body.Bye);
  sockets[0].onclose();
  run(60_000);
  assert.deepEqual([sockets.length, stages().at(-1), link.open], [1, "open", false]);
});

test("waking up leaves a live connection alone, and ends a pause", () => {
  const { link, stages } = open();
  link.wake();
  assert.deepEqual(stages(), ["connecting", "open"]);
  for (let tries = 2; tries < 10; ++tries) {
    sockets.at(-1).onclose();
    while (sockets.length < tries) run(50);
  }
  sockets.at(-1).onclose();
  const before = sockets.length;
  link.wake();
  assert.equal(sockets.length, before + 1);
  sockets.at(-1).onclose();
  run(1000); // the pauses begin again with the shortest
  assert.equal(sockets.length, before + 2);
});

test("waking up leaves a connection on which nothing was heard for long", (t) => {
  const { link, stages } = open();
  const now = performance.now();
  t.mock.method(performance, "now", () => now + 10_000);
  link.wake();
  assert.equal(sockets.length, 2);
  assert.deepEqual(stages().slice(-2), ["waiting", "connecting"]);
});

test("the clocks' offset is that of the shortest way, and an old best counts less and less", () => {
  const { link } = open();
  const second = 1_000_000_000n;
  /** An answer to a ping of `trip` ago, by a clock that is `ahead` of ours. */
  const answer = (trip, ahead) => {
    const now = BigInt(Math.round((performance.timeOrigin + performance.now()) * 1e6));
    sockets[0].receive(message(Body.Pong, (b) => Pong.createPong(b, 1n, now - trip, now - trip / 2n + ahead)));
  };
  const seconds = () => Math.round(Number(link.clockOffset_ns) / 1e9);
  answer(2n * second, 100n * second);
  assert.equal(seconds(), 100);
  answer(8n * second, 300n * second);
  assert.equal(seconds(), 100);
  assert.equal(Math.round(link.roundTrip_ms / 1000), 8);
  for (let i = 0; i < 40; ++i) answer(8n * second, 300n * second);
  assert.equal(seconds(), 300);
});
