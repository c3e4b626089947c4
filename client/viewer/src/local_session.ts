import type { FromSession, ToSession } from "./session_messages";

// A session in this browser instead of on a server: a worker that speaks the same messages, by postMessage instead of a WebSocket.

/** What a link uses of a WebSocket. */
export interface Socket {
  readonly readyState: number;
  binaryType: BinaryType;
  onopen: ((event: Event) => void) | null;
  onmessage: ((event: MessageEvent<ArrayBuffer>) => void) | null;
  onclose: ((event: CloseEvent) => void) | null;
  onerror: ((event: Event) => void) | null;
  send(bytes: Uint8Array<ArrayBuffer>): void;
  close(): void;
}

/** What became of a session that ended by a fault: why, and its recording until then if that could be saved. */
export type OnFailed = (why: string, recording: Uint8Array<ArrayBuffer> | null) => void;

const kConnecting = 0,
  kOpen = 1,
  kClosed = 3;

class LocalSocket implements Socket {
  readyState = kConnecting;
  binaryType: BinaryType = "arraybuffer";
  onopen: Socket["onopen"] = null;
  onmessage: Socket["onmessage"] = null;
  onclose: Socket["onclose"] = null;
  onerror: Socket["onerror"] = null;

  constructor(
    private readonly session: LocalSession,
    private readonly peer: number,
  ) {}

  send(bytes: Uint8Array<ArrayBuffer>): void {
    if (this.readyState === kOpen) this.session.post({ kind: "message", peer: this.peer, bytes: bytes.slice() });
  }
  close(): void {
    if (this.readyState === kClosed) return;
    this.readyState = kClosed;
    this.session.closed(this.peer);
  }

  // ---- From the session ----
  opened(): void {
    this.readyState = kOpen;
    this.onopen?.(new Event("open"));
  }
  receive(bytes: Uint8Array<ArrayBuffer>): void {
    if (this.readyState === kOpen) this.onmessage?.(new MessageEvent("message", { data: bytes.buffer }));
  }
  ended(reason: string): void {
    if (this.readyState === kClosed) return;
    this.readyState = kClosed;
    // Node has no CloseEvent, and nothing else of it is used.
    this.onclose?.({ reason } as CloseEvent);
  }
}

/** The session below a URL. Thread: the page's worker. Owns: the session's worker, which begins with the first socket. */
export class LocalSession {
  private worker: Worker | null = null;
  private readonly sockets = new Map<number, LocalSocket>();
  private lastPeer = 0;
  private readonly recordings = new Map<string, Uint8Array<ArrayBuffer>>();
  private waiting: ((capture: Uint8Array<ArrayBuffer>) => void)[] = [];
  onFailed: OnFailed = () => {};

  constructor(
    private readonly url: string,
    private readonly makeWorker: () => Worker,
  ) {}

  connect(): Socket {
    this.start();
    const peer = ++this.lastPeer;
    const socket = new LocalSocket(this, peer);
    this.sockets.set(peer, socket);
    this.post({ kind: "open", peer });
    return socket;
  }

  /** The recording so far, as a closed capture. */
  capture(): Promise<Uint8Array<ArrayBuffer>> {
    this.start();
    return new Promise((resolve) => {
      this.waiting.push(resolve);
      this.post({ kind: "capture" });
    });
  }

  /** From now on it can be replayed by this name. */
  addRecording(name: string, bytes: Uint8Array<ArrayBuffer>): void {
    this.recordings.set(name, bytes);
    if (this.worker) this.post({ kind: "recording", name, bytes });
  }

  post(message: ToSession): void {
    this.worker?.postMessage(message);
  }
  closed(peer: number): void {
    this.sockets.delete(peer);
    this.post({ kind: "close", peer });
  }

  private start(): void {
    if (this.worker) return;
    const worker = (this.worker = this.makeWorker());
    worker.onmessage = ({ data }: MessageEvent<FromSession>) => this.onMessage(data);
    worker.onerror = (event) => this.fail(event.message || "its program could not be loaded", null);
    this.post({ kind: "begin", url: this.url });
    for (const [name, bytes] of this.recordings) this.post({ kind: "recording", name, bytes });
  }

  private onMessage(message: FromSession): void {
    switch (message.kind) {
      case "opened":
        return this.sockets.get(message.peer)?.opened();
      case "message":
        return this.sockets.get(message.peer)?.receive(message.bytes);
      case "closed": {
        const socket = this.sockets.get(message.peer);
        this.sockets.delete(message.peer);
        return socket?.ended("");
      }
      case "capture": {
        const waiting = this.waiting;
        this.waiting = [];
        for (const resolve of waiting) resolve(message.bytes);
        return;
      }
      case "failed":
        return this.fail(message.text, message.capture);
    }
  }

  /** Its links connect again, to a session with the uncut body. */
  private fail(text: string, capture: Uint8Array<ArrayBuffer> | null): void {
    this.worker?.terminate();
    this.worker = null;
    this.onFailed(text, capture);
    const sockets = [...this.sockets.values()];
    this.sockets.clear();
    for (const socket of sockets) socket.ended(`The session failed: ${text}.`);
  }
}

const sessions = new Map<string, LocalSession>();

const ownWorker = () => new Worker(new URL("./session_worker.ts", import.meta.url), { type: "module" });

/** The session of this URL, which is not that of a WebSocket. */
export function localSession(url: string, makeWorker = ownWorker): LocalSession {
  let session = sessions.get(url);
  if (!session) sessions.set(url, (session = new LocalSession(url, makeWorker)));
  return session;
}

const isServer = (url: string) => /^wss?:/.test(url);

/** A connection to a server, or to a session in this browser. */
export function openSocket(url: string): Socket {
  return isServer(url) ? new WebSocket(url) : localSession(url).connect();
}
