// A session's worker: the module, its messages, and its time.

import { SessionHost } from "./session_host";
import type { ToSession } from "./session_messages";

const host = new SessionHost(
  (message, transfer) => postMessage(message, { transfer }),
  async (url) => {
    const answer = await fetch(url);
    if (!answer.ok) throw new Error(`${new URL(url).pathname}: ${answer.status} ${answer.statusText}`);
    return new Uint8Array(await answer.arrayBuffer());
  },
);
addEventListener("message", ({ data }: MessageEvent<ToSession>) => host.take(data));
