// Cutting with the mouse, in a real browser against a real server.

import assert from "node:assert/strict";
import { test } from "node:test";
import { bladeIsReady, drag, look, notices, serve, shot, strokeIsOver } from "./page.mjs";
import { progress, until } from "./server.mjs";

test("a drag of the mouse cuts the body in two, a shallow one does not", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  await bladeIsReady(page);
  await page.locator("#depth").fill("0.15");
  await drag(page, [0.66, 0.05], [0.68, 0.92]);
  await strokeIsOver(page);
  await page.waitForTimeout(500);
  assert.equal((await progress(page)).pieces, 1);
  // It has cut tissue, not the air above it, along the whole way, so deep as the slider says.
  await until(page, () => Number(document.getElementById("cut-area").textContent) > 5);
  await shot(page, "shallow_cut");
  await page.locator("#depth").fill("1");
  await drag(page, [0.42, 0.02], [0.46, 0.98]);
  await until(page, () => window.incise.progress.pieces >= 2);
  assert.equal((await progress(page)).hashAgrees, true);
  await page.locator("#open").fill("0.6");
  await shot(page, "mouse_cut");
  assert.deepEqual(faults, []);
});

test("the cut opens behind the blade while it is dragged, and what is under the pointer is where it is drawn", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  await bladeIsReady(page);
  await page.locator("#depth").fill("0.3");
  await page.evaluate(() => {
    /** How far a triangle's first corner is drawn from where it is. */
    window.movedBy = (slot) => {
      const { body, openNow } = window.incise.stage;
      const [drawn, rest] = [openNow, 0].map((open) => {
        const p = new Float64Array(9);
        body.shown(open).corners(slot, p);
        return p;
      });
      return Math.hypot(...[0, 1, 2].map((i) => drawn[i] - rest[i]));
    };
    window.widest = () => {
      const { body } = window.incise.stage;
      const { slots, isCut } = body.shown(0);
      let most = 0;
      for (let slot = 0; slot < slots; ++slot) if (isCut(slot)) most = Math.max(most, window.movedBy(slot));
      return most;
    };
  });
  const places = await page.evaluate(() => {
    const { left, right, top, bottom } = window.incise.stage.cover;
    const at = (x, y) => [left + x * (innerWidth - left - right), top + y * (innerHeight - top - bottom)];
    return [at(0.42, 0.05), at(0.45, 0.62)];
  });
  await page.mouse.move(...places[0]);
  await page.mouse.down();
  await page.mouse.move(...places[1], { steps: 30 });
  await until(page, () => window.widest() > 0.001);
  assert.ok(await page.evaluate(() => document.body.dataset.stroke === "on"));
  const under = await page.evaluate(([x, y]) => {
    const slot = window.incise.stage.pick((2 * (x + 4)) / innerWidth - 1, 1 - (2 * y) / innerHeight)?.slot;
    return slot === undefined ? null : window.movedBy(slot);
  }, places[1]);
  assert.ok(under !== null && under < 2e-4, `under the pointer the body is drawn ${under} m from where it is`);
  await shot(page, "opens_behind_blade");
  await page.mouse.up();
  await strokeIsOver(page);
  await until(page, () => window.incise.stage.body.held === 0 && window.incise.stage.atRest);
  assert.deepEqual(faults, []);
});

test("a shorter blade does not reach through, and the recording knows how long it was", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  const length = () => page.evaluate(() => Math.hypot(...window.incise.mouse.facts.tip));
  await bladeIsReady(page);
  const whole = await length();
  await page.locator("#length").fill("0.1");
  await until(
    page,
    (least) => document.body.dataset.blade === "open" && Math.hypot(...window.incise.mouse.facts.tip) < least,
    0.2 * whole,
  );
  await drag(page, [0.42, 0.02], [0.46, 0.98]);
  await strokeIsOver(page);
  await page.waitForTimeout(500);
  assert.equal((await progress(page)).pieces, 1);
  await page.locator("#length").fill("1");
  await until(
    page,
    (least) => document.body.dataset.blade === "open" && Math.hypot(...window.incise.mouse.facts.tip) > least,
    0.9 * whole,
  );
  await drag(page, [0.46, 0.02], [0.48, 0.98]);
  await until(page, () => window.incise.progress.pieces >= 2);
  await server.stop();
  const { batches } = JSON.parse(server.incise("replay", server.file("session.capture"), "--verify", "--json"));
  assert.ok(batches > 1);
  assert.deepEqual(faults, []);
});

test("a flick cuts as well as a slow hand, and one that stalls on its way", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  await bladeIsReady(page);
  // Two events for the whole way: the blade may not be faster than the server takes for a motion.
  await drag(page, [0.42, 0.02], [0.46, 0.98], 2);
  await until(page, () => window.incise.progress.pieces >= 2);
  // The page hangs in the middle of a stroke for longer than the server waits for a pose.
  await page.evaluate(() => {
    const stage = window.incise.stage;
    const began = performance.now();
    const hang = setInterval(() => {
      if (!document.body.dataset.stroke && performance.now() - began < 60_000) return;
      clearInterval(hang);
      const until = performance.now() + 700;
      while (performance.now() < until) stage.framesDrawn;
    }, 1);
  });
  await drag(page, [0.62, 0.02], [0.64, 0.98]);
  await until(page, () => window.incise.progress.pieces >= 3);
  assert.equal((await progress(page)).hashAgrees, true);
  assert.equal((await server.stats()).strokes, 2);
  assert.deepEqual(faults, []);
});

test("a stroke that cuts nothing says so, one that cuts does not; without a recording none can be undone", async (t) => {
  const server = await serve(t, { capture: { path: "" } });
  const { page, faults } = await look(t, server.url);
  await bladeIsReady(page);
  const cutsNothing = () =>
    until(page, () => [...document.querySelectorAll(".notice p")].some((p) => p.textContent.includes("cut nothing")));
  await drag(page, [0.03, 0.3], [0.03, 0.95]);
  await cutsNothing();
  await shot(page, "missed");
  // What is said at the top is in nobody's way: a stroke that begins there begins below it.
  const said = await page.locator(".notice p").boundingBox();
  const under = ([x, y]) => page.evaluate(([x, y]) => document.elementFromPoint(x, y).id, [x, y]);
  assert.equal(await under([said.x + 5, said.y + said.height / 2]), "picture");
  await page.evaluate(() => document.querySelector(".notice").remove());
  // At a limited depth the server never hears of it: the blade has no skin to follow.
  await page.locator("#depth").fill("0.2");
  await drag(page, [0.03, 0.3], [0.03, 0.95]);
  await cutsNothing();
  await page.evaluate(() => document.querySelector(".notice").remove());
  await page.locator("#depth").fill("1");
  await drag(page, [0.42, 0.02], [0.46, 0.98]);
  await until(page, () => window.incise.progress.pieces >= 2 && !document.body.dataset.stroke);
  // Not even for the second until the server says what there is to undo.
  assert.equal(await page.locator("#undo").isDisabled(), true);
  assert.match(await page.getAttribute("#undo", "title"), /keeps no recording/);
  await page.waitForTimeout(500);
  assert.deepEqual(await notices(page), []);
  assert.deepEqual(faults, []);
});

test("a second window is told who holds the blade, and can take it", async (t) => {
  const server = await serve(t);
  const first = await look(t, server.url);
  await bladeIsReady(first.page);
  const second = await look(t, server.url);
  await second.page.getByText("Another window holds the mouse's blade").waitFor();
  await shot(second.page, "blade_taken");
  await second.page.getByRole("button", { name: "Take it over" }).click();
  await bladeIsReady(second.page);
  await first.page.getByText("Another window has taken the blade").waitFor();
  await first.page.close();
  assert.deepEqual([...first.faults, ...second.faults], []);
});
