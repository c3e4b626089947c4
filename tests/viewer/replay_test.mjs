// Recordings, in a real browser against a real server.

import assert from "node:assert/strict";
import { mkdirSync, renameSync } from "node:fs";
import { test } from "node:test";
import { atRevision, look, notices, shot } from "./page.mjs";
import { progress, Server, until } from "./server.mjs";

test("a recording is replayed in a scratch copy, and the live mesh stays as it is", async (t) => {
  const server = new Server();
  t.after(() => server.end());
  server.config.capture = { path: "captures/first.capture", library: "captures" };
  mkdirSync(server.file("captures"));
  await server.start();
  server.stream([0.03, -0.03]);
  const recorded = await server.stats();
  await server.stop();
  renameSync(server.file("captures/first.capture"), server.file("captures/old.capture"));
  await server.start();

  const { page, faults } = await look(t, server.url);
  await page.locator("#panel-toggle").click();
  await page.getByRole("button", { name: "old", exact: true }).click();
  await until(page, () => window.incise.replay.facts !== null);
  const scrub = (revision) =>
    page.locator("#scrub").evaluate((e, r) => {
      e.valueAsNumber = r;
      e.dispatchEvent(new Event("change"));
    }, revision);
  await scrub(recorded.revision);
  await until(page, (r) => window.incise.progress.revision === r, recorded.revision);
  assert.equal((await progress(page)).hash, recorded.state_hash);
  assert.equal((await progress(page)).pieces, 3);
  await shot(page, "replay");
  // The body follows the hand, before it lets go.
  await page.locator("#scrub").evaluate((e) => {
    for (const revision of [4, 3, 2, 1]) {
      e.valueAsNumber = revision;
      e.dispatchEvent(new Event("input"));
    }
  });
  await atRevision(page, 1);
  assert.equal((await progress(page)).hashAgrees, true);
  await scrub(2);
  await until(page, () => window.incise.progress.revision === 2);
  await page.keyboard.press("n");
  await until(page, () => window.incise.progress.revision === 3);
  await page.getByRole("button", { name: "Next batch" }).click();
  await atRevision(page, 4);
  await page.locator("#speed").selectOption("16");
  await page.getByRole("button", { name: "Play" }).click();
  await until(page, (r) => window.incise.progress.revision === r, recorded.revision);
  assert.equal((await progress(page)).hash, recorded.state_hash);
  assert.equal((await server.stats()).revision, 0);
  await page.getByRole("button", { name: "Back to live" }).click();
  await until(page, () => window.incise.replay.facts === null && window.incise.progress.revision === 0);
  assert.equal((await progress(page)).hashAgrees, true);
  assert.deepEqual(await notices(page), []); // nobody has reset anything
  assert.deepEqual(faults, []);
});
