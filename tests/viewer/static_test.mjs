// The page without a server: the session runs in the browser.

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { cpSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { atRevision, bladeIsReady, drag, look, notices, shot, strokeIsOver, theBrowser } from "./page.mjs";
import { rampAt, writeRamp } from "./inside_bodies.mjs";
import { paintedCube } from "./painted.mjs";
import { bin, progress, until } from "./server.mjs";
import { serveFiles, staticFolder } from "./static_server.mjs";

function replayed(capture) {
  const done = spawnSync(join(bin, "incise"), ["replay", capture, "--verify", "--json"], { encoding: "utf8" });
  assert.equal(done.status, 0, done.stderr);
  return JSON.parse(done.stdout);
}

/** What the button Save gives, as a file. */
async function saved(page) {
  const download = page.waitForEvent("download");
  await page.evaluate(() => document.getElementById("save-recording").click());
  return (await download).path();
}

const openPanel = (page) => page.evaluate(() => window.incise.look.togglePanel(true));
const quiet = (page) =>
  page.evaluate(async () => {
    let revision = -1;
    while (revision !== window.incise.progress.revision) {
      revision = window.incise.progress.revision;
      await new Promise((resolve) => setTimeout(resolve, 700));
    }
  });

test("the mouse cuts the liver in two, and incise replay of the saved recording gives the same hash", async (t) => {
  const { page, faults } = await look(t, await serveFiles(t), { acceptDownloads: true });
  await bladeIsReady(page);
  assert.equal(await page.textContent("#connection-text"), "In this page");
  await drag(page, [0.52, 0.02], [0.46, 0.98], 10);
  await until(page, () => window.incise.progress.pieces >= 2);
  await page.locator("#depth").fill("0.2");
  await quiet(page);
  const first = await progress(page);
  await drag(page, [0.66, 0.05], [0.68, 0.92], 10);
  await strokeIsOver(page);
  await quiet(page);
  const shown = await progress(page);
  assert.equal(shown.hashAgrees, true);
  assert.equal(await page.textContent("#hash-text"), "Checked: it agrees with the session in this page");
  assert.equal(await page.textContent("#blades"), "mouse (you)");
  await page.locator("#open").fill("0.5");
  await openPanel(page);
  await shot(page, "static_cut");

  const report = replayed(await saved(page));
  assert.deepEqual([report.state_hash, report.batches], [shown.hash, shown.revision]);

  // What is undone is not replayed.
  await page.locator("#undo").click();
  await until(page, (hash) => window.incise.progress.hash === hash, first.hash);
  assert.deepEqual(
    [replayed(await saved(page)).state_hash, (await progress(page)).revision],
    [first.hash, first.revision],
  );

  // After a reset the recording is that of what follows.
  await page.locator("#depth").fill("1");
  await page.evaluate(() => window.incise.look.togglePanel(false));
  await page.locator("#reset").click();
  await page.locator("#reset-dialog").getByRole("button", { name: "Reset" }).click();
  await atRevision(page, 0);
  assert.equal((await progress(page)).pieces, 1);
  await drag(page, [0.56, 0.02], [0.5, 0.98], 8);
  await until(page, () => window.incise.progress.pieces >= 2);
  await quiet(page);
  const again = await progress(page);
  assert.equal(replayed(await saved(page)).state_hash, again.hash);
  assert.notEqual(again.hash, shown.hash);
  assert.deepEqual(faults, []);
});

test("a recording of the folder and one from a file are played, and the session goes on", async (t) => {
  const { page, faults } = await look(t, await serveFiles(t), { acceptDownloads: true });
  await bladeIsReady(page);
  await drag(page, [0.52, 0.02], [0.46, 0.98], 8);
  await until(page, () => window.incise.progress.pieces >= 2);
  await strokeIsOver(page);
  await quiet(page);
  const own = await progress(page);
  const file = await saved(page);

  await openPanel(page);
  await page.getByRole("button", { name: "demo", exact: true }).click();
  await until(page, () => window.incise.replay.facts !== null && window.incise.progress.revision === 0);
  const demo = replayed(join(staticFolder, "session/demo.capture"));
  await page.locator("#speed").selectOption("16");
  await page.getByRole("button", { name: "Play" }).click();
  await atRevision(page, demo.batches);
  const played = await progress(page);
  assert.deepEqual([played.hash, played.hashAgrees], [demo.state_hash, true]);
  await shot(page, "static_replay");
  const seek = (revision) =>
    page.locator("#scrub").evaluate((e, r) => {
      e.valueAsNumber = window.incise.replay.placeOf(r);
      e.dispatchEvent(new Event("change"));
    }, revision);
  await seek(3);
  await atRevision(page, 3);
  await page.getByRole("button", { name: "Back to live" }).click();
  await until(page, (hash) => window.incise.progress.hash === hash, own.hash);

  await page.locator("#open-recording").setInputFiles(file);
  await until(page, () => window.incise.replay.facts !== null);
  await seek(own.revision);
  await until(page, (hash) => window.incise.progress.hash === hash, own.hash);
  await page.getByRole("button", { name: "Back to live" }).click();
  await until(page, () => window.incise.replay.facts === null);
  assert.equal((await progress(page)).hash, own.hash);
  assert.deepEqual(await notices(page), []);
  assert.deepEqual(faults, []);
});

test("what is no recording of this body gets one clear line, and changes nothing", async (t) => {
  const { page, faults } = await look(t, await serveFiles(t));
  await bladeIsReady(page);
  const refused = async (name, buffer, text) => {
    await page.locator("#open-recording").setInputFiles({ name, mimeType: "application/octet-stream", buffer });
    await page.getByText(text).waitFor();
  };
  await refused("photo.capture", Buffer.alloc(5000, 7), "photo.capture:");
  await refused("empty.capture", Buffer.alloc(0), "empty.capture");
  const replays = new URL("../replay/", import.meta.url).pathname;
  await page.locator("#open-recording").setInputFiles(join(replays, "planar_conforming.capture"));
  await page.getByText("was recorded with another body").waitFor();
  assert.equal((await progress(page)).revision, 0);
  await drag(page, [0.52, 0.02], [0.46, 0.98], 8);
  await until(page, () => window.incise.progress.pieces >= 2);
  assert.deepEqual(faults, []);
});

test("a folder with a damaged session says what is wrong", async (t) => {
  const folder = mkdtempSync(join(tmpdir(), "incise_static_"));
  t.after(() => rmSync(folder, { recursive: true, force: true }));
  cpSync(staticFolder, folder, { recursive: true });
  writeFileSync(join(folder, "session/body.bin"), Buffer.alloc(300, 1));
  const page = await theBrowser().newPage();
  t.after(() => page.close());
  await page.goto(await serveFiles(t, folder));
  await page.getByText("The session failed: the body's file:").first().waitFor();
});

test("a body's texture and its volume image come with the folder, and stay right after a cut, an undo and a replay", async (t) => {
  const folder = mkdtempSync(join(tmpdir(), "incise_static_"));
  t.after(() => rmSync(folder, { recursive: true, force: true }));
  paintedCube(folder);
  const ramp = writeRamp(folder);
  const config = join(folder, "config.json");
  writeFileSync(
    config,
    JSON.stringify({
      mesh: { path: "cube.obj", target_tets: 3000, image: "ramp.nrrd", image_window: [0, 1000] },
      blade: { heel: [0, 0, 0], tip: [0, 0, -0.12] },
    }),
  );
  const rows = ["t_s,x_m,y_m,z_m,qw,qx,qy,qz,button"];
  for (let i = 0; i <= 60; ++i)
    rows.push([i / 60, 0.06, -0.05 + (0.2 * i) / 60, 0.11, 1, 0, 0, 0, i < 60 ? 1 : 0].join());
  const motion = join(folder, "motion.csv");
  writeFileSync(motion, `${rows.join("\n")}\n`);
  const site = join(folder, "site");
  cpSync(staticFolder, site, { recursive: true });
  const run = (program, ...args) => {
    const done = spawnSync(join(bin, program), args, { encoding: "utf8" });
    assert.equal(done.status, 0, done.stderr);
    return done.stderr;
  };
  const capture = join(folder, "through.capture");
  run("incise", "convert", motion, "--mesh", join(folder, "cube.obj"), "--config", config, "--out", capture);
  assert.match(run("incise-static-body", capture, join(site, "session")), /third argument/); // of what is left out
  assert.equal(run("incise-static-body", capture, join(site, "session"), config), "");

  const { page, faults } = await look(t, await serveFiles(t, site));
  await bladeIsReady(page);
  const defined = (name) => until(page, (n) => window.incise.stage.body.mesh.material.defines[n] === 1, name);
  await defined("TEXTURE");
  /** The colour where these places of the body are seen from this direction. */
  const coloursAt = (points, from) =>
    page.evaluate(
      async ([places, direction]) => {
        const { stage } = window.incise;
        stage.setOpen(0, true);
        stage.lookFrom(direction);
        while (!stage.atRest) await new Promise((done) => setTimeout(done, 50));
        stage.render();
        const gl = stage.renderer.getContext();
        return places.map((p) => {
          const v = stage.camera.position
            .clone()
            .set(...p)
            .project(stage.camera);
          const pixel = new Uint8Array(4);
          const x = ((v.x + 1) / 2) * gl.drawingBufferWidth,
            y = ((v.y + 1) / 2) * gl.drawingBufferHeight;
          gl.readPixels(x, y, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
          return [...pixel];
        });
      },
      [points, from],
    );
  const isPainted = async () => {
    const [low, high] = await coloursAt(
      [
        [0.03, 0, 0.025],
        [0.03, 0, 0.075],
      ],
      [0, -1, 0.2],
    );
    assert.ok(low[1] > 1.5 * low[0] && low[1] > 1.5 * low[2], `green: ${low}`);
    assert.ok(high[2] > 1.5 * high[0] && high[2] > 1.5 * high[1], `blue: ${high}`);
  };
  await isPainted();
  await drag(page, [0.5, 0.02], [0.5, 0.98], 10);
  await until(page, () => window.incise.progress.pieces >= 2);
  await strokeIsOver(page);
  await quiet(page);
  await isPainted();
  await page.locator("#undo").click();
  await atRevision(page, 0);
  await isPainted();
  await openPanel(page);
  await page.getByRole("button", { name: "through", exact: true }).click();
  await until(page, () => window.incise.replay.facts !== null);
  await page.locator("#scrub").evaluate((e) => {
    e.value = e.max;
    e.dispatchEvent(new Event("change"));
  });
  await until(page, () => window.incise.progress.pieces === 2);
  await isPainted();
  // The image, on a plane through it.
  await page.keyboard.press("v");
  await defined("IMAGE");
  const z = await page.evaluate(() => {
    window.incise.look.showState({ inside: "image", section: { normal: [0, 0, 1], share: 0.5 } });
    return window.incise.stage.plane[3];
  });
  const places = [0.03, 0.05, 0.08].map((x) => [x, 0.06, z]);
  for (const [i, colour] of (await coloursAt(places, [0.05, -0.3, 1])).entries()) {
    assert.ok(ramp.covers(places[i]) > 1);
    assert.ok(Math.abs(colour[0] - 255 * rampAt(places[i])) <= 3, `${colour}, wanted ${255 * rampAt(places[i])}`);
  }
  await shot(page, "static_image");
  assert.deepEqual(await notices(page), []);
  assert.deepEqual(faults, []);
});
