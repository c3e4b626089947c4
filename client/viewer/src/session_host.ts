import type { FromSession, ToSession } from "./session_messages";
import { WasmSession } from "./wasm_session";

type Post = (message: FromSession, transfer: Transferable[]) => void;
type Load = (url: string) => Promise<Uint8Array<ArrayBuffer>>;

const kSlice_ms = 8; // work between two looks at the messages
const kTick_ms = 1000;

const textOf = (error: unknown) => (error instanceof Error ? error.message : String(error));

/** Runs a session: hands messages to it and takes its own, and gives it time. Thread: the session's worker. */
export class SessionHost {
  private session: WasmSession | null = null;
  private url = "";
  private early: ToSession[] | null = []; // until the session has begun
  private stopped = false;
  private readonly recordings = new Map<string, Uint8Array>();
  private timer: ReturnType<typeof setTimeout> | undefined;
  private ticker: ReturnType<typeof setInterval> | undefined;
  private readonly channel = new MessageChannel(); // a timer would wait 4 ms
  private working = false; // a turn is on its way through the channel

  constructor(
    private readonly post: Post,
    private readonly load: Load,
  ) {
    this.channel.port1.onmessage = () => {
      this.working = false;
      this.guard(() => this.work());
    };
  }

  take(message: ToSession): void {
    if (this.stopped) return;
    if (message.kind === "begin") {
      this.url = message.url;
      void this.begin();
    } else if (this.early) {
      this.early.push(message);
    } else {
      this.guard(() => this.dispatch(message));
    }
  }

  /** Nothing more is done. */
  stop(): void {
    this.stopped = true;
    clearInterval(this.ticker);
    clearTimeout(this.timer);
    this.channel.port1.close();
  }

  private async begin(): Promise<void> {
    try {
      const [code, header, body] = await Promise.all(
        ["incise.wasm", "header.capture", "body.bin"].map((name) => this.load(this.url + name)),
      );
      const module = await WebAssembly.compile(code);
      if (this.stopped) return;
      this.session = new WasmSession(module, {
        send: (peer, bytes) => this.post({ kind: "message", peer, bytes }, [bytes.buffer]),
        close: (peer) => this.post({ kind: "closed", peer }, []),
        fetchCapture: (name) => void this.fetchCapture(name),
      });
      this.session.begin(header, body);
    } catch (error) {
      this.fail(error);
      return;
    }
    this.ticker = setInterval(() => this.guard(() => this.session?.tick()), kTick_ms);
    const early = this.early ?? [];
    this.early = null;
    for (const message of early) this.take(message);
  }

  private dispatch(message: ToSession): void {
    const session = this.session!;
    switch (message.kind) {
      case "open":
        session.open(message.peer);
        this.post({ kind: "opened", peer: message.peer }, []);
        return;
      case "message":
        session.receive(message.peer, message.bytes);
        break;
      case "close":
        session.closed(message.peer);
        break;
      case "capture": {
        const bytes = session.capture();
        this.post({ kind: "capture", bytes }, [bytes.buffer]);
        return;
      }
      case "recording":
        this.recordings.set(message.name, message.bytes);
        return;
    }
    this.soon(0);
  }

  private async fetchCapture(name: string): Promise<void> {
    let capture: Uint8Array | string;
    try {
      capture = this.recordings.get(name) ?? (await this.load(this.url + encodeURIComponent(name)));
    } catch (error) {
      capture = `${name} could not be loaded: ${textOf(error)}`;
    }
    await Promise.resolve(); // the session has asked from within a call
    this.guard(() => {
      this.session!.offerCapture(name, capture);
      this.soon(0);
    });
  }

  private work(): void {
    const again_ms = this.session!.work(kSlice_ms);
    if (again_ms >= 0) this.soon(again_ms);
  }

  private soon(ms: number): void {
    clearTimeout(this.timer);
    if (ms >= 1) {
      this.timer = setTimeout(() => this.soon(0), ms);
    } else if (!this.working) {
      this.working = true;
      this.channel.port2.postMessage(null);
    }
  }

  /** Any error of the session is its end. */
  private guard(what: () => void): void {
    if (this.stopped) return;
    try {
      what();
    } catch (error) {
      this.fail(error);
    }
  }

  private fail(error: unknown): void {
    this.stop();
    let capture: Uint8Array<ArrayBuffer> | null = null;
    try {
      capture = this.session?.capture() ?? null; // its memory is still there
    } catch {
      // Then it is lost.
    }
    this.post({ kind: "failed", text: textOf(error), capture }, capture ? [capture.buffer] : []);
  }
}
