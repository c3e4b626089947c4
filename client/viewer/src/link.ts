import * as flatbuffers from "flatbuffers";
import { openSocket, type Socket } from "./local_session";
import type { Vec3 } from "./messages";
import { BladeEdge } from "./wire/incise/wire/blade-edge";
import { Body } from "./wire/incise/wire/body";
import { Bye } from "./wire/incise/wire/bye";
import { ByeReason } from "./wire/incise/wire/bye-reason";
import { Error as WireError } from "./wire/incise/wire/error";
import { ErrorCode } from "./wire/incise/wire/error-code";
import { Hello } from "./wire/incise/wire/hello";
import { Message } from "./wire/incise/wire/message";
import { Ping } from "./wire/incise/wire/ping";
import { Pong } from "./wire/incise/wire/pong";
import type { Role } from "./wire/incise/wire/role";
import { Vec3 as WireVec3 } from "./wire/incise/wire/vec3";
import type { View } from "./wire/incise/wire/view";
import { Welcome } from "./wire/incise/wire/welcome";

/** The state of a link; `text` is for the user. */
export interface LinkState {
  /** stalled: still connected, but the server does not answer. */
  stage: "connecting" | "open" | "stalled" | "waiting" | "ended";
  text: string;
  /** Why it ended, so that the page can offer a way on. */
  reason?: "token" | "taken" | "handed-over" | "version" | "unavailable";
  retryAt?: number; // ms of Date.now()
}

export interface HelloFields {
  role: Role;
  view: View;
  token: string;
  sourceName?: string;
  takeOver?: boolean;
  bladeRate_hz?: number;
  maxRate_hz?: number;
  blade?: { heel: Vec3; tip: Vec3 }; // an operator's own
  resumeSession?: bigint;
  resumeRevision?: bigint;
  resumeHash?: bigint;
}

export interface LinkEvents {
  hello(): HelloFields;
  welcome(welcome: Welcome): void;
  /** Any other message; its arrays may be kept. */
  message(type: Body, message: Message, bytes: number): void;
  state(state: LinkState): void;
  /** The server refused a request; the connection stays. */
  refused(text: string): void;
  /** A message could not be read; the link connects again. */
  unreadable(): void;
}

const kSocketOpen = 1; // WebSocket.OPEN
const kFirstPause_ms = 250;
const kLongestPause_ms = 8000;
const kCheckEvery_ms = 400;
// Checks in a row during which nothing came from the server, which is pinged at each. They are counted, not timed: a
// worker that was busy for seconds reads what has arrived before the next check.
const kStalledAfter = 3;
const kDeadAfter = 22;
const kSilence_ms = 9000; // after sleep or a change of network the connection is dead

const kOpen: LinkState = { stage: "open", text: "Connected" };

/** Absolute time in ns, of the page and its worker alike. */
export function now_ns(): bigint {
  return BigInt(Math.round((performance.timeOrigin + performance.now()) * 1e3)) * 1000n;
}

/** One connection to the server that comes back by itself. Thread: the worker's. */
export class Link {
  private socket: Socket | null = null;
  private sequence = 0n;
  private pause_ms = 0;
  private timer: ReturnType<typeof setTimeout> | undefined;
  private checker: ReturnType<typeof setInterval> | undefined;
  private quietChecks = 0;
  private pinged = false; // a ping is unanswered
  private lastHeard_ms = 0;
  private ended = false;
  private lost = ""; // why, if the server said so before the connection ended
  /** The server's monotonic clock minus ours, ns; from the ping with the shortest round trip. */
  clockOffset_ns = 0n;
  private bestRoundTrip_ns = 1n << 62n;
  roundTrip_ms = 0;

  constructor(
    private readonly url: string,
    private readonly events: LinkEvents,
  ) {
    this.connect();
  }

  get open(): boolean {
    return this.welcomed;
  }
  private welcomed = false;

  /** Connects now instead of at the end of the pause. */
  wake(): void {
    if (this.ended) return;
    if (this.socket && performance.now() - this.lastHeard_ms > kSilence_ms) {
      this.drop("Nothing was heard from the server.");
    }
    if (this.timer !== undefined) {
      this.pause_ms = 0;
      this.connect();
    }
  }

  /** Ends the connection as a network loss would; it is opened again. */
  drop(text = "The connection was lost."): void {
    const socket = this.socket;
    if (!socket) return;
    socket.onclose = socket.onmessage = socket.onerror = null;
    socket.close();
    this.onClosed(text);
  }

  end(): void {
    this.ended = true;
    clearTimeout(this.timer);
    clearInterval(this.checker);
    if (this.socket?.readyState === kSocketOpen) {
      this.send(Body.Bye, (b) => Bye.createBye(b, ByeReason.Done, 0));
    }
    this.socket?.close();
    this.socket = null;
    this.welcomed = false;
  }

  send(type: Body, make: (builder: flatbuffers.Builder) => flatbuffers.Offset): bigint {
    if (this.socket?.readyState !== kSocketOpen) return 0n;
    const builder = new flatbuffers.Builder(1024);
    const body = make(builder);
    const sequence = ++this.sequence;
    Message.startMessage(builder);
    Message.addSequence(builder, sequence);
    Message.addSentNs(builder, now_ns());
    Message.addBodyType(builder, type);
    Message.addBody(builder, body);
    Message.finishMessageBuffer(builder, Message.endMessage(builder));
    this.socket.send(builder.asUint8Array() as Uint8Array<ArrayBuffer>);
    return sequence;
  }

  private connect(): void {
    clearTimeout(this.timer);
    this.timer = undefined;
    this.events.state({ stage: "connecting", text: "Connecting to the server…" });
    const socket = (this.socket = openSocket(this.url));
    socket.binaryType = "arraybuffer";
    this.sequence = 0n;
    this.lost = "";
    this.lastHeard_ms = performance.now();
    this.quietChecks = 0;
    this.pinged = false;
    socket.onopen = () => {
      const fields = this.events.hello();
      this.send(Body.Hello, (b) => makeHello(b, fields));
    };
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => this.onMessage(event.data);
    socket.onclose = (event) => {
      this.lost ||= event?.reason ?? "";
      this.onClosed("The server does not answer.");
    };
    clearInterval(this.checker);
    this.checker = setInterval(() => this.check(), kCheckEvery_ms);
  }

  private check(): void {
    if (++this.quietChecks >= kDeadAfter) {
      this.drop("Nothing was heard from the server.");
      return;
    }
    if (!this.welcomed) return;
    if (this.quietChecks === kStalledAfter)
      this.events.state({ stage: "stalled", text: "The server does not answer." });
    this.ping();
  }

  /** One unanswered ping at a time, so that they do not pile up if the server does not read. */
  private ping(): void {
    if (this.pinged) return;
    this.pinged = true;
    this.send(Body.Ping, (b) => Ping.createPing(b, 1n, now_ns()));
  }

  private onClosed(text: string): void {
    const was = this.welcomed;
    this.socket = null;
    this.welcomed = false;
    clearInterval(this.checker);
    if (this.ended) return;
    this.pause_ms = was ? kFirstPause_ms : Math.min(kLongestPause_ms, Math.max(kFirstPause_ms, 2 * this.pause_ms));
    const pause = this.pause_ms * (0.8 + 0.4 * Math.random());
    this.timer = setTimeout(() => this.connect(), pause);
    const why = this.lost || (was ? "The connection was lost." : text);
    this.events.state({ stage: "waiting", text: `${why} Trying again…`, retryAt: Date.now() + pause });
  }

  private onMessage(data: ArrayBuffer): void {
    this.lastHeard_ms = performance.now();
    const stalled = this.welcomed && this.quietChecks >= kStalledAfter;
    this.quietChecks = 0;
    if (stalled) this.events.state(kOpen);
    try {
      this.read(data);
    } catch (error) {
      // FlatBuffers has no verifier here: an offset beyond the message throws when it is read.
      console.error(error);
      this.events.unreadable();
      this.drop("The server sent something that cannot be read.");
    }
  }

  private read(data: ArrayBuffer): void {
    const buffer = new flatbuffers.ByteBuffer(new Uint8Array(data));
    if (data.byteLength < 16 || !Message.bufferHasIdentifier(buffer)) {
      this.drop("The server sent something that is not a message.");
      return;
    }
    const message = Message.getRootAsMessage(buffer);
    const type = message.bodyType();
    switch (type) {
      case Body.Welcome:
        this.welcomed = true;
        this.pause_ms = 0;
        this.bestRoundTrip_ns = 1n << 62n;
        this.events.welcome(message.body(new Welcome()));
        this.events.state(kOpen);
        this.ping();
        break;
      case Body.Ping: {
        const ping: Ping = message.body(new Ping());
        this.send(Body.Pong, (b) => Pong.createPong(b, ping.nonce(), ping.sentNs(), now_ns()));
        break;
      }
      case Body.Pong:
        this.onPong(message.body(new Pong()));
        break;
      case Body.Error:
        this.onError(message.body(new WireError()));
        break;
      case Body.Bye:
        this.onBye(message.body(new Bye()));
        break;
      default:
        this.events.message(type, message, data.byteLength);
    }
  }

  private onPong(pong: Pong): void {
    this.pinged = false;
    const now = now_ns();
    const trip = now - pong.pingSentNs();
    this.roundTrip_ms = Number(trip) / 1e6;
    this.bestRoundTrip_ns += this.bestRoundTrip_ns / 16n; // an old best counts less and less: clocks drift
    if (trip < this.bestRoundTrip_ns) {
      this.bestRoundTrip_ns = trip;
      this.clockOffset_ns = pong.receivedNs() - (pong.pingSentNs() + now) / 2n;
    }
  }

  private onError(error: WireError): void {
    const text = error.text() ?? "";
    if (!error.fatal()) {
      this.events.refused(text);
      return;
    }
    switch (error.code()) {
      case ErrorCode.Unauthorized:
        return this.giveUp("token", "This server needs a token.");
      case ErrorCode.BladeTaken:
      case ErrorCode.UnknownSource:
        return this.giveUp("taken", "Somebody else holds the blade. You can watch, or take it over.");
      case ErrorCode.BadVersion:
        return this.giveUp("version", "This page and the server have different versions. Reload the page.");
      case ErrorCode.TooManySessions:
        this.lost = "The server is full.";
        break;
      default:
        this.lost = `The server refused: ${text}.`;
    }
  }

  private onBye(bye: Bye): void {
    switch (bye.reason()) {
      case ByeReason.ServerStops:
        this.lost = "The server has stopped.";
        break;
      case ByeReason.HandedOver:
        this.giveUp("handed-over", "Another window has taken the blade. You can watch, or take it back.");
        break;
      case ByeReason.TooSlow:
        this.lost = "This computer could not keep up with the stream.";
        break;
      default:
        this.lost ||= "The server ended the connection.";
    }
  }

  private giveUp(reason: LinkState["reason"], text: string): void {
    if (this.ended) return;
    this.end();
    this.events.state({ stage: "ended", text, reason });
  }
}

function makeHello(builder: flatbuffers.Builder, fields: HelloFields): flatbuffers.Offset {
  const name = builder.createString("incise viewer");
  const token = builder.createString(fields.token);
  const source = fields.sourceName ? builder.createString(fields.sourceName) : 0;
  const edge = fields.blade ? makeEdge(builder, fields.blade) : 0;
  Hello.startHello(builder);
  Hello.addProtocolVersion(builder, 2);
  Hello.addRole(builder, fields.role);
  Hello.addView(builder, fields.view);
  Hello.addClientName(builder, name);
  Hello.addToken(builder, token);
  Hello.addResumeSession(builder, fields.resumeSession ?? 0n);
  Hello.addResumeRevision(builder, fields.resumeRevision ?? 0n);
  if (source) Hello.addSourceName(builder, source);
  Hello.addTakeOver(builder, fields.takeOver ?? false);
  Hello.addBladeRateHz(builder, fields.bladeRate_hz ?? 0);
  Hello.addMaxRateHz(builder, fields.maxRate_hz ?? 0);
  if (edge) Hello.addBlade(builder, edge);
  Hello.addResumeHash(builder, fields.resumeHash ?? 0n);
  return Hello.endHello(builder);
}

function makeEdge(builder: flatbuffers.Builder, blade: { heel: Vec3; tip: Vec3 }): flatbuffers.Offset {
  BladeEdge.startBladeEdge(builder);
  BladeEdge.addHeel(builder, WireVec3.createVec3(builder, ...blade.heel));
  BladeEdge.addTip(builder, WireVec3.createVec3(builder, ...blade.tip));
  return BladeEdge.endBladeEdge(builder);
}
