// The page without a server, from Debian's own file server as a user would start it.

import { spawn } from "node:child_process";
import { once } from "node:events";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { bin } from "./server.mjs";

export const staticFolder = join(bin, "../static");

/** Serves the folder on a free port until the test ends; its URL. */
export async function serveFiles(t, folder = staticFolder) {
  const server = spawn("python3", ["-u", "-m", "http.server", "0", "--bind", "127.0.0.1", "--directory", folder], {
    stdio: ["ignore", "pipe", "ignore"],
  });
  t.after(async () => {
    const ended = once(server, "exit");
    server.kill();
    await ended;
  });
  for await (const line of createInterface({ input: server.stdout })) {
    const port = /port (\d+)/.exec(line);
    if (port) return `http://127.0.0.1:${port[1]}/`;
  }
  throw new Error("python3 -m http.server ended before it listened");
}
