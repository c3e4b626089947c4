// The page of a relay: the origin's body, with its texture, cut by a mouse that is connected to the relay.

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { once } from "node:events";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { test } from "node:test";
import { atRevision, bladeIsReady, drag, look, serve, shot } from "./page.mjs";
import { paintedCube } from "./painted.mjs";
import { bin, progress, until } from "./server.mjs";

/** incise-relay of `server`; ends with the test. Its page's address. */
async function relay(t, server) {
  const { tcp_port, http_port } = server.ports;
  const place = ["--to", `127.0.0.1:${tcp_port}`, "--upstream-http-port", http_port];
  const started = spawn(join(bin, "incise-relay"), [...place, "--port", "0", "--http-port", "0"].map(String), {
    stdio: ["ignore", "pipe", "ignore"],
  });
  t.after(async () => {
    const ended = once(started, "exit");
    started.kill();
    await ended;
  });
  for await (const line of createInterface({ input: started.stdout })) {
    const ports = /^listening tcp=[^:]*:\d+ http=[^:]*:(\d+)/.exec(line);
    if (ports) return `http://127.0.0.1:${ports[1]}/`;
  }
  throw new Error("incise-relay ended before it listened");
}

test("a relay's page shows the origin's body and texture, and its mouse cuts there", async (t) => {
  const files = mkdtempSync(join(tmpdir(), "incise_relayed_"));
  t.after(() => rmSync(files, { recursive: true }));
  paintedCube(files);
  const server = await serve(t, { mesh: { path: join(files, "cube.obj"), target_tets: 4000 } });
  const url = await relay(t, server);
  const { page, faults } = await look(t, url);
  await until(page, () => window.incise.stage.body.mesh.material.defines.TEXTURE === 1 && window.incise.stage.atRest);
  await shot(page, "relay_painted");

  server.stream([0.06], { depth_m: 0.12 }); // somebody cuts at the origin
  const streamed = await server.stats();
  await atRevision(page, streamed.revision);
  assert.equal((await progress(page)).hash, streamed.state_hash);
  assert.ok((await progress(page)).pieces > 1);

  await bladeIsReady(page);
  await drag(page, [0.35, 0.2], [0.35, 0.9]); // and we do, here
  await until(page, (before) => window.incise.progress.revision > before, streamed.revision);
  await until(page, () => window.incise.stage.atRest);
  const cut = await server.stats();
  assert.ok(cut.poses.accepted > streamed.poses.accepted);
  await atRevision(page, cut.revision);
  assert.equal((await progress(page)).hash, cut.state_hash);
  await shot(page, "relay_cut");
  const shown = await (await fetch(`${url}stats`)).json();
  assert.equal(shown.relay.refused, 0);
  assert.equal(shown.state_hash, cut.state_hash);
  assert.deepEqual(faults, []);
});
