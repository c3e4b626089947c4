import { Link } from "./link";
import type { Post } from "./messages";
import { Body } from "./wire/incise/wire/body";
import { Reset } from "./wire/incise/wire/reset";
import { Role } from "./wire/incise/wire/role";
import { Undo } from "./wire/incise/wire/undo";
import { View } from "./wire/incise/wire/view";

const kPatience_ms = 5000; // a server that does not do it has said so by then

/** Connects as an administrator, resets the body or undoes the last stroke, and leaves. */
export function askAdmin(url: string, token: string, what: "reset" | "undo", post: Post): void {
  let asked = false;
  const admin: Link = new Link(url, {
    hello: () => ({ role: Role.Admin, view: View.None, token }),
    welcome: () => {
      // The second Welcome is the reset's.
      if (asked) return admin.end();
      asked = true;
      if (what === "reset") admin.send(Body.Reset, (b) => Reset.createReset(b));
      else admin.send(Body.Undo, (b) => Undo.createUndo(b, true));
      setTimeout(() => admin.end(), kPatience_ms);
    },
    message: () => {},
    state: (state) => {
      if (state.stage === "waiting") admin.end();
      if (state.stage !== "open") post({ kind: "link", which: "admin", state });
    },
    refused: (text) => post({ kind: "notice", text }),
    unreadable: () => {},
  });
}
