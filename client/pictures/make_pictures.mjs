// Makes the README's pictures from the viewer page, fed by the programs as they are.
//
//   ./dev build && node client/pictures/make_pictures.mjs [PRESET]
//
// PRESET is whose programs and page are used (default: release). Needs Chromium. Replays the demo's motion in the page and
// writes client/pictures/viewer.png and cut_liver.png.

import { mkdirSync } from "node:fs";
import { fileURLToPath } from "node:url";

const here = new URL(".", import.meta.url);
const root = new URL("../../", here);
process.env.INCISE_BIN_DIR ??= fileURLToPath(new URL(`build/${process.argv[2] ?? "release"}/bin`, root));
const { launch, openPage, Server, until } = await import(new URL("tests/viewer/server.mjs", root));

const server = new Server({
  mesh: { phantom: "liver", target_tets: 60000 },
  capture: { library: "captures" },
});
mkdirSync(server.file("captures"));
await server.start();
server.incise(
  "convert",
  fileURLToPath(new URL("config/demo_motion.csv", root)),
  "--config",
  server.file("server.json"),
  "--out",
  server.file("captures/demo.capture"),
);

const browser = await launch();

/** A page that stands at the end of the demo's motion. */
async function open(options) {
  const { page } = await openPage(browser, server.url, options);
  const end = await page.evaluate(async () => {
    await window.incise.replay.list();
    [...document.querySelectorAll("#captures button")][0].click();
    while (!window.incise.replay.facts) await new Promise((done) => setTimeout(done, 50));
    const scrub = document.getElementById("scrub");
    scrub.value = scrub.max;
    scrub.dispatchEvent(new Event("change"));
    return window.incise.replay.facts.lastRevision;
  });
  await until(page, (r) => window.incise.progress.revision === r, end);
  return page;
}

/** Takes the picture once it rests, at full sharpness. */
async function shoot(page, name) {
  await page.evaluate(() => document.activeElement.blur());
  await page.waitForTimeout(3000);
  await page.screenshot({ path: fileURLToPath(new URL(name, here)) });
  await page.context().close();
}

const whole = await open({ width: 1280, height: 760 });
await whole.locator("#open").fill("0.6");
await shoot(whole, "viewer.png");

const body = await open({ width: 1000, height: 520, colorScheme: "light" });
await body.evaluate(() => {
  for (const part of document.querySelectorAll("body > :not(#picture)")) part.style.display = "none";
  const { stage } = window.incise;
  stage.setCover({ left: 0, right: 0, top: 0, bottom: 0 });
  stage.fit(true);
  stage.zoom(0.86);
});
await body.evaluate(() => window.incise.stage.setOpen(0.85, true));
await shoot(body, "cut_liver.png");

await browser.close();
await server.end();
