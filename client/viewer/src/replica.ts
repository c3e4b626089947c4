import { Surface } from "./surface";
import type { SnapshotBegin } from "./wire/incise/wire/snapshot-begin";
import type { SnapshotChunk } from "./wire/incise/wire/snapshot-chunk";
import type { SnapshotEnd } from "./wire/incise/wire/snapshot-end";
import type { SurfaceDelta } from "./wire/incise/wire/surface-delta";
import { View } from "./wire/incise/wire/view";
import type { Welcome } from "./wire/incise/wire/welcome";

/** Asks the server for the whole state; given what is held and why it is not good. */
export type AskForState = (revision: bigint, hash: bigint, reason: string) => void;

/** The server's surface, followed by snapshots and deltas and checked by its hash. Thread: the worker's. */
export class Replica {
  readonly surface = new Surface();
  session = 0n;
  revision = 0n;
  /** The server's hash of the volume; whether its hash of the surface is the one computed here. */
  stateHash = 0n;
  agrees = true;
  /** A whole state is here; deltas follow. */
  holding = false;
  private staged: SnapshotChunk[] | null = null;
  private resyncing = false;

  constructor(private readonly askForState: AskForState) {}

  welcome(welcome: Welcome): void {
    this.staged = null;
    this.resyncing = false;
    if (welcome.session() !== this.session) this.holding = false;
    this.session = welcome.session();
  }

  /** What is held cannot be trusted: the next connection starts with a snapshot. */
  distrust(): void {
    this.holding = false;
  }

  beginSnapshot(begin: SnapshotBegin): void {
    this.staged = begin.view() === View.Surface ? [] : null;
  }

  addChunk(chunk: SnapshotChunk): void {
    this.staged?.push(chunk);
  }

  /** True: the surface was replaced. */
  endSnapshot(end: SnapshotEnd): boolean {
    if (!this.staged) return false;
    this.surface.clear();
    let good = true;
    for (const chunk of this.staged) {
      good =
        this.surface.setVertices(chunk.surfaceVertices()) &&
        this.surface.setRest(chunk.surfaceRest()) &&
        this.surface.setTriangles(chunk.triangles()) &&
        good;
    }
    this.staged = null;
    this.resyncing = false;
    this.holding = true;
    this.revision = end.revision();
    this.check(good, end.surfaceHash(), end.stateHash());
    return true;
  }

  /** True: it was applied. */
  apply(delta: SurfaceDelta): boolean {
    if (!this.holding || this.resyncing || this.staged) return false;
    if (delta.baseRevision() !== this.revision) {
      this.resync("the delta does not follow on the state");
      return false;
    }
    const good =
      this.surface.setVertices(delta.vertices()) &&
      this.surface.setRest(delta.rest()) &&
      this.surface.setTriangles(delta.triangles());
    this.surface.removeTriangles(delta.removedTrianglesArray());
    this.surface.removeVertices(delta.removedVerticesArray());
    this.revision = delta.revision();
    this.check(good, delta.surfaceHash(), delta.stateHash());
    return true;
  }

  private check(good: boolean, surfaceHash: bigint, stateHash: bigint): void {
    this.stateHash = stateHash;
    this.agrees = good && surfaceHash === this.surface.surfaceHash;
    if (!this.agrees) this.resync(good ? "the surface hash differs" : "the arrays do not fit the state");
  }

  private resync(reason: string): void {
    this.resyncing = true;
    this.askForState(this.revision, this.surface.surfaceHash, reason);
  }
}
