// The page in Firefox: it draws, cuts, undoes, and its section is dragged.

import assert from "node:assert/strict";
import { statSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { Firefox } from "./firefox.mjs";
import { screenshots, Server } from "./server.mjs";

test("Firefox draws the body, cuts it, undoes that and shows a section", async (t) => {
  const server = new Server();
  t.after(() => server.end());
  await server.start();
  const page = await Firefox.launch(1000, 700);
  t.after(() => page.close());
  await page.goto(server.url);
  await page.until(
    () => window.incise?.progress && document.body.dataset.blade === "open" && window.incise.stage.atRest,
  );
  assert.equal(await page.evaluate(() => window.incise.progress.hashAgrees), true);
  /** Where the middle of the body is, and its colour there. */
  const middle = () =>
    page.evaluate(() => {
      const { stage } = window.incise;
      const { x, y } = stage.centre.clone().project(stage.camera);
      return {
        at: [((x + 1) / 2) * innerWidth, ((1 - y) / 2) * innerHeight],
        colour: stage.colourAt((x + 1) / 2, (1 - y) / 2),
      };
    });
  const {
    at: [x, y],
    colour,
  } = await middle();
  assert.ok(colour[0] > 60 && colour[0] > 1.5 * colour[2], `tissue: ${colour}`);

  await page.drag([x + 30, y - 230], [x - 10, y + 230]);
  await page.until(() => window.incise.progress.pieces > 1 && !document.body.dataset.stroke);
  const cut = await server.stats();
  await page.until((hash) => window.incise.progress.hash === hash, cut.state_hash);
  assert.equal(await page.evaluate(() => window.incise.progress.hashAgrees), true);
  await page.until(() => window.incise.stage.openNow > 0.29 && window.incise.stage.atRest);
  await page.screenshot(join(screenshots, "firefox_cut.png"));
  assert.ok(statSync(join(screenshots, "firefox_cut.png")).size > 20_000);

  await page.press("s");
  await page.until(() => window.incise.stage.plane !== null && window.incise.stage.atRest);
  const handle = () => page.evaluate(() => window.incise.stage.marks.onScreen(window.incise.look.handle.frame().foot));
  const plane = () => page.evaluate(() => window.incise.stage.plane);
  const before = await plane();
  const [hx, hy] = await handle();
  await page.drag([hx, hy], [hx, hy - 40]);
  const after = await plane();
  assert.deepEqual(after.slice(0, 3), before.slice(0, 3));
  assert.ok(after[3] > before[3] + 0.003, `${before[3]} ${after[3]}`);
  await page.until(() => window.incise.stage.atRest);
  await page.screenshot(join(screenshots, "firefox_section.png"));
  await page.press("s");

  await page.press("z");
  await page.until(() => window.incise.progress.revision === 0 && window.incise.progress.hashAgrees);
  assert.equal((await server.stats()).revision, 0);
  assert.deepEqual(page.faults, []);
});
