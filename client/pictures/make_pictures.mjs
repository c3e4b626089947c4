// Makes the README's pictures from the viewer page, fed by the programs as they are.
//
//   ./dev build && node client/pictures/make_pictures.mjs [PRESET]
//
// PRESET is whose programs and page are used (default: release). Needs Chromium. Replays the demo's motion in the page and
// writes client/pictures/viewer.png, cut_liver.png and image_in_cut.png.

import { mkdirSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { writePhantomCt } from "./phantom_ct.mjs";

const here = new URL(".", import.meta.url);
const root = new URL("../../", here);
process.env.INCISE_BIN_DIR ??= fileURLToPath(new URL(`build/${process.argv[2] ?? "release"}/bin`, root));
const { launch, openPage, Server, until } = await import(new URL("tests/viewer/server.mjs", root));

const server = new Server({
  capture: { library: "captures" },
});
server.config.mesh = {
  phantom: "liver",
  target_tets: 60000,
  image: writePhantomCt(server.file("ct.nrrd")),
  image_window: [0, 220],
};
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
  await page.waitForTimeout(6000);
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

// The image, live: a stroke right through, and a section.
const { page: live } = await openPage(browser, server.url, { width: 1280, height: 720 });
await until(live, () => document.body.dataset.blade === "open");
await live.evaluate(() => window.incise.stage.lookFrom([0, -0.2, 1]));
await until(live, () => window.incise.stage.atRest);
await live.mouse.move(420, 90);
await live.mouse.down();
for (let i = 1; i <= 40; ++i) {
  await live.mouse.move(420 + 2 * i, 90 + 13 * i);
  await live.waitForTimeout(20);
}
await live.mouse.up();
await until(live, () => window.incise.progress.pieces > 1);
await live.mouse.move(640, 5);
await live.locator("#open").fill("0.75");
await live.evaluate(() => {
  const { stage, look } = window.incise;
  look.showState({ inside: "image", section: { normal: [0, 0, 1], share: 0.56 } });
  stage.lookFrom([-0.5, -0.5, 0.75]);
});
await live.waitForTimeout(1000);
await live.locator("#inside").scrollIntoViewIfNeeded();
await shoot(live, "image_in_cut.png");

await browser.close();
await server.end();
