import type { LinkState } from "./link";
import type { Corners } from "./corner_buffers";
import type { Look } from "./look_source";
import type { Revisions } from "./timeline";

// The messages between the page and its worker. Large arrays are transferred, not copied.

export type Vec3 = [number, number, number];

export interface Facts {
  session: string;
  meshName: string;
  tets: number;
  vertices: number;
  meanEdge_m: number;
  min: Vec3;
  max: Vec3;
  policy: string;
  server: string;
  frameRate_hz: number;
  revision: number;
  live: boolean; // else of a recording that is being replayed
}

/** An operator's own blade, in the tool's frame. */
export interface BladeFacts {
  heel: Vec3;
  tip: Vec3;
  source: number;
  name: string;
  engageButton: number;
  maxSpeed_m_s: number;
}

/** Where a blade's edge went in one batch. */
export interface BladeStep {
  source: number;
  own: boolean;
  stroke: number;
  revision: number;
  arrived_ms: number; // the last pose, on the server's clock
  heel: Vec3;
  tip: Vec3;
  ended: boolean; // the stroke ended with this batch
  cutArea_m2: number; // one side
}

export interface Progress {
  revision: number;
  tets: number;
  triangles: number;
  pieces: number;
  hash: string;
  hashAgrees: boolean;
  deltas: number; // since the page was loaded
  bytes: number;
}

export interface ReplayFacts {
  capture: string;
  playing: boolean;
  speed: number;
  revision: number;
  lastRevision: number;
  text: string;
  timeline?: Revisions; // once, when a recording was opened that has one
}

export type Post = (message: FromWorker, transfer?: Transferable[]) => void;

export type ToWorker =
  /** local: the URL is that of a session's files, which runs in this browser. */
  | { kind: "connect"; url: string; token: string; local: boolean }
  | { kind: "take-blade"; takeOver: boolean; length_m: number }
  | { kind: "release-blade" }
  | { kind: "name-blade"; name: string }
  /** Poses: 9 numbers each: time in ms (absolute), position, quaternion w x y z, buttons. */
  | { kind: "poses"; poses: Float64Array }
  | { kind: "reset" }
  /** Back to before the last stroke; `others`: also where other blades have cut since. */
  | { kind: "undo"; others: boolean }
  /** Asks for the area of the cut that this half-face is a face of. */
  | { kind: "cut-area"; halfFace: number }
  | { kind: "colour-by-quality"; on: boolean }
  | {
      kind: "replay";
      action: "open" | "play" | "pause" | "step" | "seek" | "close";
      capture?: string;
      speed?: number;
      revision?: number;
    }
  /** Of a session in this browser. */
  | { kind: "save-recording" }
  | { kind: "open-recording"; name: string; bytes: Uint8Array<ArrayBuffer> }
  | { kind: "applied" } // the page has applied the last patch or geometry
  | { kind: "wake" }
  | { kind: "drop" } // for tests: as if the network were lost
  | { kind: "dump" }; // for tests: all triangles

/** What has changed since the last patch. */
export interface Patch {
  kind: "patch";
  slots: Uint32Array;
  highest: number; // slot in use, plus 1
  corners: Corners;
  steps: BladeStep[];
  progress: Progress;
  /** When the last pose that led to this change was made, ms of absolute time; 0: no pose did. */
  posed_ms: number;
}

export interface BladeForce {
  source: number;
  at: Vec3; // where it is shown
  newtons: Vec3; // world frame; zero: none acts
}

export type FromWorker =
  | { kind: "link"; which: "view" | "blade" | "admin"; state: LinkState }
  | { kind: "facts"; facts: Facts }
  | { kind: "blade"; facts: BladeFacts }
  | { kind: "geometry"; slots: number; capacity: number; corners: Corners; progress: Progress }
  | Patch
  /**
   * By how much corners and pieces are moved when the body is fully opened: 3 numbers a corner, 4 a piece's row;
   * metres.
   */
  | { kind: "opening"; lips: Float32Array; pieces: Float32Array; cutArea_m2: number }
  | { kind: "cut-area"; halfFace: number; area_m2: number }
  /** Where another blade is now. */
  | { kind: "blade-pose"; source: number; heel: Vec3; tip: Vec3; cutting: boolean }
  /** The force on the hand that holds a blade, when it has changed. */
  | { kind: "force"; force: BladeForce }
  | { kind: "stats"; json: string; roundTrip_ms: number; recorded: boolean; undoable: number }
  | { kind: "replay"; facts: ReplayFacts | null }
  /** What the layers of Corners.texture are: sRGB, 4 bytes a pixel, the lowest row first. Before the first geometry with such corners. */
  | { kind: "texture"; size: number; layers: number; pixels: Uint8Array<ArrayBuffer> }
  /** How its regions look and what is in it; once, or when the server says something else. */
  | { kind: "look"; look: Look }
  /** A simulation moves the body: cuts open by themselves. */
  | { kind: "deforms" }
  /** The state here differs from the server's; a geometry follows. */
  | { kind: "differs" }
  /** The live body was reset, or a stroke was undone; `by`: who did it, where the server says so; `others`: the other blades whose cuts were undone. */
  | { kind: "was-reset"; undone: boolean; by: string; others: string[] }
  | { kind: "notice"; text: string }
  /** Of a session in this browser: what was asked for, or what was saved of a session that failed. */
  | { kind: "recording"; bytes: Uint8Array<ArrayBuffer>; after: "asked" | "failure" }
  | { kind: "dump"; triangles: Float32Array };
