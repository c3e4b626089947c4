// The messages between the page's worker and a session's.

export type ToSession =
  /** url: of the folder with body.bin, header.capture, incise.wasm and the recordings. The first message. */
  | { kind: "begin"; url: string }
  | { kind: "open"; peer: number }
  | { kind: "message"; peer: number; bytes: Uint8Array<ArrayBuffer> } // as a server gets it by WebSocket
  | { kind: "close"; peer: number }
  | { kind: "capture" }
  | { kind: "recording"; name: string; bytes: Uint8Array<ArrayBuffer> };

export type FromSession =
  | { kind: "opened"; peer: number }
  | { kind: "message"; peer: number; bytes: Uint8Array<ArrayBuffer> }
  | { kind: "closed"; peer: number }
  | { kind: "capture"; bytes: Uint8Array<ArrayBuffer> }
  /** Nothing more comes. */
  | { kind: "failed"; text: string; capture: Uint8Array<ArrayBuffer> | null };
