import type { CornerBuilder } from "./corner_buffers";
import { Elements } from "./elements";
import { Link } from "./link";
import { Body } from "./wire/incise/wire/body";
import { Delta } from "./wire/incise/wire/delta";
import type { Message } from "./wire/incise/wire/message";
import { Resync } from "./wire/incise/wire/resync";
import { Role } from "./wire/incise/wire/role";
import { SnapshotChunk } from "./wire/incise/wire/snapshot-chunk";
import { SnapshotEnd } from "./wire/incise/wire/snapshot-end";
import { View } from "./wire/incise/wire/view";

const kRate_hz = 20;

/**
 * The tetrahedra behind the surface, received on a separate connection while the page colours by their quality. Not
 * in a replay, which only the viewer's connection sees. Thread: the worker's.
 */
export class ElementsLink {
  private link: Link | null = null;
  private elements = new Elements();
  private revision = 0n;

  /** changed: called when colours have changed. */
  constructor(
    private readonly builder: CornerBuilder,
    private readonly changed: () => void,
    private readonly refused: (text: string) => void,
  ) {}

  follow(wanted: boolean, url: string, token: string): void {
    if (wanted === (this.link !== null)) return;
    this.builder.elements = null;
    if (wanted) return this.open(url, token);
    this.link?.end();
    this.link = null;
    this.show();
  }

  private open(url: string, token: string): void {
    this.elements = new Elements();
    this.link = new Link(url, {
      hello: () => ({ role: Role.Viewer, view: View.Volume, token, maxRate_hz: kRate_hz }),
      welcome: () => (this.builder.elements = null),
      message: (type, message) => this.onMessage(type, message),
      state: () => {}, // the page shows that of the viewer's link
      refused: this.refused,
      unreadable: () => (this.builder.elements = null),
    });
  }

  private onMessage(type: Body, message: Message): void {
    switch (type) {
      case Body.SnapshotBegin:
        this.builder.elements = null;
        this.elements.clear();
        return;
      case Body.SnapshotChunk:
        return this.elements.addChunk(message.body(new SnapshotChunk()));
      case Body.SnapshotEnd:
        this.revision = message.body(new SnapshotEnd()).revision();
        this.builder.elements = this.elements;
        return this.show();
      case Body.Delta:
        return this.onDelta(message.body(new Delta()));
    }
  }

  private onDelta(delta: Delta): void {
    if (!this.builder.elements) return; // a snapshot is on its way
    if (delta.baseRevision() !== this.revision) {
      this.builder.elements = null;
      this.link?.send(Body.Resync, (b) =>
        Resync.createResync(b, this.revision, 0n, b.createString("the delta does not follow on the state")),
      );
      return;
    }
    this.elements.apply(delta);
    this.revision = delta.revision();
    this.show();
  }

  private show(): void {
    this.builder.touchByQuality();
    this.changed();
  }
}
