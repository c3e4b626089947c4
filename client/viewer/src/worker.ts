// The worker: connections, the state, its hash, and the corners to draw, off the page's main thread.

import { Blade } from "./blade";
import { ElementsLink } from "./elements_link";
import { type LocalSession, localSession } from "./local_session";
import type { Post, ToWorker } from "./messages";
import { askAdmin } from "./reset";
import { Viewer } from "./viewer";

const post: Post = (message, transfer = []) => postMessage(message, { transfer });

/** Passes each of the page's messages to the part that handles it. */
class Dispatch {
  private url = "";
  private token = "";
  private session: LocalSession | null = null; // in this browser
  private colourByQuality = false;
  private readonly blade = new Blade(post);
  private readonly viewer = new Viewer(this.blade, post);
  private readonly elements = new ElementsLink(
    this.viewer.feed.builder,
    () => this.viewer.feed.sendChanges(),
    (text) => post({ kind: "notice", text }),
  );

  constructor() {
    this.viewer.onReplaying = () => this.followElements();
  }

  take(message: ToWorker): void {
    switch (message.kind) {
      case "connect":
        this.url = message.url;
        this.token = message.token;
        this.session = message.local ? this.follow(localSession(this.url)) : null;
        return this.viewer.connect(this.url, this.token);
      case "take-blade":
        return this.blade.take(this.url, this.token, message.takeOver, message.length_m);
      case "name-blade":
        return this.blade.rename(message.name);
      case "release-blade":
        return this.blade.release();
      case "poses":
        return this.blade.send(message.poses);
      case "reset":
        return askAdmin(this.url, this.token, "reset", post);
      case "undo":
        if (!this.blade.undo(message.others)) askAdmin(this.url, this.token, "undo", post);
        return;
      case "cut-area":
        return this.viewer.measureCut(message.halfFace);
      case "colour-by-quality":
        this.colourByQuality = message.on;
        return this.followElements();
      case "replay":
        return this.viewer.controlReplay(message);
      case "save-recording":
        void this.session?.capture().then((bytes) => this.postRecording(bytes, "asked"));
        return;
      case "open-recording":
        this.session?.addRecording(message.name, message.bytes);
        return this.viewer.controlReplay({ kind: "replay", action: "open", capture: message.name });
      case "applied":
        return this.viewer.feed.applied();
      case "wake":
        this.viewer.wake();
        return this.blade.wake();
      case "drop":
        return this.viewer.drop();
      case "dump":
        return post({ kind: "dump", triangles: this.viewer.dump() });
    }
  }

  private follow(session: LocalSession): LocalSession {
    session.onFailed = (why, recording) => {
      post({ kind: "notice", text: `The session failed: ${why}. It begins again with the uncut body.` });
      if (recording) this.postRecording(recording, "failure");
    };
    return session;
  }

  private postRecording(bytes: Uint8Array<ArrayBuffer>, after: "asked" | "failure"): void {
    post({ kind: "recording", bytes, after }, [bytes.buffer]);
  }

  private followElements(): void {
    this.elements.follow(this.colourByQuality && !this.viewer.replaying, this.url, this.token);
  }
}

const dispatch = new Dispatch();
addEventListener("message", ({ data }: MessageEvent<ToWorker>) => dispatch.take(data));
