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
      e.valueAsNumber = window.incise.replay.placeOf(r);
      e.dispatchEvent(new Event("change"));
    }, revision);
  const last = recorded.revision;
  const tets = () => page.locator("#tets").textContent();
  const uncut = await tets();
  await scrub(recorded.revision);
  await until(page, (r) => window.incise.progress.revision === r, recorded.revision);
  assert.equal((await progress(page)).hash, recorded.state_hash);
  assert.equal((await progress(page)).pieces, 3);
  assert.notEqual(await tets(), uncut);
  await shot(page, "replay");
  // The body follows the hand, before it lets go.
  await page.locator("#scrub").evaluate((e) => {
    for (const revision of [4, 3, 2, 0]) {
      e.valueAsNumber = window.incise.replay.placeOf(revision);
      e.dispatchEvent(new Event("input"));
    }
  });
  await atRevision(page, 0);
  assert.equal((await progress(page)).hashAgrees, true);
  assert.equal(await tets(), uncut); // a step back is a snapshot
  // Two strokes are two bars, and a place on the timeline is a moment of one of them.
  await scrub(0);
  const bars = await page.evaluate(() => window.incise.replay.bars);
  assert.deepEqual(
    bars.map((bar) => [bar.stroke, bar.first, bar.last]),
    [
      [1, 1, bars[1].first - 1],
      [2, bars[1].first, last],
    ],
  );
  assert.ok(bars[0].from_ms < bars[0].to_ms && bars[0].to_ms < bars[1].from_ms && bars[1].from_ms < bars[1].to_ms);
  const box = await page.locator("#timeline").boundingBox();
  const middle = (bars[1].from_ms + bars[1].to_ms) / 2 / bars[1].to_ms;
  await page.mouse.move(box.x + 2 + middle * (box.width - 4), box.y + 15);
  await page.mouse.down();
  await until(page, (bar) => window.incise.progress.revision >= bar.first, bars[1]);
  const there = (await progress(page)).revision;
  assert.ok(there > bars[1].first && there < last, `${there}`);
  assert.match(await page.getAttribute("#scrub", "title"), /^Stroke 2 of blade 1: [\d.]+ to [\d.]+ s, revisions/);
  assert.match(await page.textContent("#scrub-text"), new RegExp(`^[\\d.]+ / [\\d.]+ s · ${there} / ${last}$`));
  await shot(page, "timeline");
  await page.mouse.up();
  await page.keyboard.press("ArrowRight");
  await atRevision(page, there + 1);
  await page.keyboard.press("PageUp"); // the begin of this stroke, of the one before
  await atRevision(page, bars[1].first - 1);
  await page.keyboard.press("PageUp");
  await atRevision(page, 0);
  await page.keyboard.press("End");
  await atRevision(page, last);
  await page.evaluate(() => window.incise.replay.go(2));
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
