// The session as a module of WebAssembly: its functions (server/wasm/exports.cpp), and what it needs of the world.

/** What the session sends and asks for. Called from within its functions: answer later. */
export interface SessionEvents {
  send(peer: number, message: Uint8Array<ArrayBuffer>): void;
  close(peer: number): void;
  fetchCapture(name: string): void;
}

export interface ReplayReport {
  revision: number;
  state_hash: string;
  marks: number;
  compared: number;
  differs: number;
  ms: number;
}

interface Exports {
  memory: WebAssembly.Memory;
  _initialize(): void;
  incise_input(size: number): number;
  incise_output_at(): number;
  incise_output_size(): number;
  incise_begin(headerSize: number): number;
  incise_open(peer: number): number;
  incise_receive(peer: number): number;
  incise_closed(peer: number): number;
  incise_work(ms: number): number;
  incise_tick(): number;
  incise_capture(): number;
  incise_offer_capture(nameSize: number, found: number): number;
  incise_replay(): number;
}

const kFailed = -2;
const kBadDescriptor = 8; // WASI's EBADF
const kRealtime = 0; // WASI's clock

const now_ns = () => BigInt(Math.round((performance.timeOrigin + performance.now()) * 1e3)) * 1000n;

/** Thrown by all functions; the session is of no use afterwards if it was an abort. */
export class SessionError extends Error {
  constructor(
    text: string,
    readonly aborted: boolean,
  ) {
    super(text);
  }
}

/** One instance, on the thread that made it. */
export class WasmSession {
  private readonly exports: Exports;
  private failure = "";
  private printed = ""; // on its standard error: what an abort says

  constructor(
    module: WebAssembly.Module,
    private readonly events: SessionEvents,
  ) {
    const instance = new WebAssembly.Instance(module, { incise: this.host(), wasi_snapshot_preview1: this.system() });
    this.exports = instance.exports as unknown as Exports;
    this.exports._initialize();
  }

  /** header: a capture's; body: as incise-static-body wrote it. */
  begin(header: Uint8Array, body: Uint8Array): void {
    this.put(header, body);
    this.call(() => this.exports.incise_begin(header.length));
  }
  open(peer: number): void {
    this.call(() => this.exports.incise_open(peer));
  }
  receive(peer: number, message: Uint8Array): void {
    this.put(message);
    this.call(() => this.exports.incise_receive(peer));
  }
  closed(peer: number): void {
    this.call(() => this.exports.incise_closed(peer));
  }
  /** Works for about so long. In how many ms it wants to work again; negative: not before a message. */
  work(ms: number): number {
    return this.call(() => this.exports.incise_work(ms));
  }
  tick(): void {
    this.call(() => this.exports.incise_tick());
  }
  capture(): Uint8Array<ArrayBuffer> {
    this.call(() => this.exports.incise_capture());
    return this.output();
  }
  /** Answers fetchCapture: the capture, or why there is none. */
  offerCapture(name: string, capture: Uint8Array | string): void {
    const encoder = new TextEncoder();
    const title = encoder.encode(name);
    this.put(title, typeof capture === "string" ? encoder.encode(capture) : capture);
    this.call(() => this.exports.incise_offer_capture(title.length, typeof capture === "string" ? 0 : 1));
  }
  /** Cuts the body as a capture says, apart from the session. */
  replay(capture: Uint8Array): ReplayReport {
    this.put(capture);
    this.call(() => this.exports.incise_replay());
    return JSON.parse(new TextDecoder().decode(this.output()));
  }

  private put(...parts: Uint8Array[]): void {
    const size = parts.reduce((sum, part) => sum + part.length, 0);
    let at = this.call(() => this.exports.incise_input(size));
    const memory = new Uint8Array(this.exports.memory.buffer);
    for (const part of parts) {
      memory.set(part, at);
      at += part.length;
    }
  }

  private output(): Uint8Array<ArrayBuffer> {
    return this.bytes(this.exports.incise_output_at() >>> 0, this.exports.incise_output_size());
  }

  /** A copy: the module's memory moves when it grows. */
  private bytes(at: number, size: number): Uint8Array<ArrayBuffer> {
    return new Uint8Array(this.exports.memory.buffer as ArrayBuffer).slice(at >>> 0, (at >>> 0) + size);
  }
  private text(at: number, size: number): string {
    return new TextDecoder().decode(this.bytes(at, size));
  }

  private call(what: () => number): number {
    this.printed = "";
    let result: number;
    try {
      result = what();
    } catch (error) {
      throw new SessionError(this.printed.trim() || String(error), true);
    }
    if (result === kFailed) throw new SessionError(this.failure, false);
    return result;
  }

  private host() {
    return {
      send: (peer: number, at: number, size: number) => this.events.send(peer, this.bytes(at, size)),
      close: (peer: number) => this.events.close(peer),
      fetch_capture: (at: number, size: number) => this.events.fetchCapture(this.text(at, size)),
      failed: (at: number, size: number) => {
        this.failure = this.text(at, size);
      },
    };
  }

  /** What the C library asks of the system (WASI preview 1): clocks, random numbers, a place for what it prints. */
  private system() {
    const view = () => new DataView(this.exports.memory.buffer);
    const none = () => kBadDescriptor;
    return {
      clock_time_get: (clock: number, _precision: bigint, at: number) => {
        const time = clock === kRealtime ? BigInt(Date.now()) * 1_000_000n : now_ns();
        view().setBigUint64(at, time, true);
        return 0;
      },
      random_get: (at: number, size: number) => {
        crypto.getRandomValues(new Uint8Array(this.exports.memory.buffer as ArrayBuffer, at, size));
        return 0;
      },
      fd_write: (_fd: number, parts: number, count: number, writtenAt: number) => {
        let written = 0;
        for (let i = 0; i < count; ++i) {
          const size = view().getUint32(parts + 8 * i + 4, true);
          this.printed += this.text(view().getUint32(parts + 8 * i, true), size);
          written += size;
        }
        view().setUint32(writtenAt, written, true);
        return 0;
      },
      environ_sizes_get: (countAt: number, sizeAt: number) => {
        view().setUint32(countAt, 0, true);
        view().setUint32(sizeAt, 0, true);
        return 0;
      },
      environ_get: () => 0,
      fd_close: none,
      fd_seek: none,
      proc_exit: (status: number) => {
        throw new Error(`it ended with status ${status}`);
      },
    };
  }
}
