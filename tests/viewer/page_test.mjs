// The viewer page, in a real browser against a real server.

import assert from "node:assert/strict";
import { mkdirSync, readFileSync, renameSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { launch, openPage, progress, screenshots, Server, until } from "./server.mjs";
import { boundaryOfVtu, canonical } from "./triangles.mjs";

let browser;
before(async () => (browser = await launch()));
after(async () => browser?.close());

async function serve(t, config, ...args) {
  const server = new Server(config);
  t.after(() => server.end());
  await server.start(...args);
  return server;
}

async function look(t, url, options) {
  const opened = await openPage(browser, url, options);
  t.after(() => opened.close());
  return opened;
}

const shot = (page, name) => page.screenshot({ path: join(screenshots, `${name}.png`) });

/** Drags across the picture, in shares of its free part. */
async function drag(page, from, to, steps = 30) {
  const free = await page.evaluate(() => {
    const { left, right, top, bottom } = window.incise.stage.cover;
    return { x: left, y: top, width: innerWidth - left - right, height: innerHeight - top - bottom };
  });
  const at = (p) => [free.x + p[0] * free.width, free.y + p[1] * free.height];
  await page.mouse.move(...at(from));
  await page.mouse.down();
  for (let i = 1; i <= steps; ++i) {
    await page.mouse.move(...at([0, 1].map((k) => from[k] + ((to[k] - from[k]) * i) / steps)));
    await page.waitForTimeout(8);
  }
  await page.mouse.up();
}

const bladeIsReady = (page) => until(page, () => document.body.dataset.blade === "open");

test("the page loads, shows the body and checks its hash", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  const state = await progress(page);
  assert.equal(state.revision, 0);
  assert.equal(state.hashAgrees, true);
  assert.equal(await page.textContent("#connection-text"), "Live");
  assert.match(await page.textContent("#body-name"), /^liver, [\d,]+ tetrahedra$/);
  await until(page, () => window.incise.stage.framesDrawn > 0);
  await shot(page, "loaded_dark");
  // Something red is in the middle, and not at the edge.
  const red = await page.evaluate(() => window.incise.stage.colourAt(0.5, 0.5));
  assert.ok(red[0] > 1.5 * red[2] && red[3] === 255, `found ${red}`);
  assert.deepEqual(faults, []);
});

test("a picture at rest is drawn no more, and one that moves is", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  const drawn = () => page.evaluate(() => window.incise.stage.framesDrawn);
  const resolution = () => page.evaluate(() => window.incise.stage.renderer.getPixelRatio());
  const comesToRest = () => until(page, () => window.incise.stage.atRest);
  await comesToRest();
  const still = await drawn();
  await page.waitForTimeout(1500);
  assert.equal(await drawn(), still);
  assert.equal(await resolution(), 2); // of a renderer that smooths no edges
  await page.evaluate(() => {
    let n = 0;
    const turn = () => {
      window.incise.stage.turn(0.5, 0);
      window.whileTurning = window.incise.stage.renderer.getPixelRatio();
      if (++n < 30) requestAnimationFrame(turn);
    };
    turn();
  });
  await until(page, (before) => window.incise.stage.framesDrawn >= before + 15, still);
  await comesToRest();
  assert.ok(await page.evaluate(() => window.whileTurning < 1));
  assert.equal(await resolution(), 2);
  // A blade that has come to rest vanishes by itself.
  server.stream([0.2]);
  await until(page, () => window.incise.stage.bladesShown > 0);
  await until(page, () => window.incise.stage.bladesShown === 0 && window.incise.stage.atRest);
  assert.deepEqual(faults, []);
});

test("a streamed cut changes the picture, and the page's triangles are those of the export", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  await until(page, () => window.incise.stage.framesDrawn > 0);
  const before = await page.locator("#picture").screenshot();
  server.stream([0.03, -0.03]);
  const { revision } = await server.stats();
  assert.ok(revision >= 4, `revision ${revision}`);
  await until(page, (r) => window.incise.progress.revision === r, revision);
  await until(page, () => window.incise.progress.pieces >= 3);
  assert.equal((await progress(page)).hashAgrees, true);
  assert.equal(await page.getAttribute("#hash-row", "data-agrees"), "true");
  const seen = await page.locator("#picture").screenshot();
  assert.notDeepEqual(seen, before);
  await shot(page, "streamed_cut");

  const shown = await page.evaluate(async () => Array.from(await window.incise.dump()));
  await server.stop();
  const vtu = server.file("end.vtu");
  server.incise("export", server.file("session.capture"), "--out", vtu);
  assert.deepEqual(canonical(Float32Array.from(shown)), canonical(boundaryOfVtu(vtu)));
  // What the graphics card draws is what the worker holds, slot by slot.
  const drawn = await page.evaluate(() => Array.from(window.incise.stage.body.drawnTriangles()));
  assert.deepEqual(canonical(Float32Array.from(drawn)), canonical(Float32Array.from(shown)));
  assert.deepEqual(faults, []);
});

/** The smallest dihedral angle of the tetrahedron behind each boundary face of TetGen files, degrees; sorted. */
function boundaryAngles(base) {
  const rows = (ending) => readFileSync(base + ending, "utf8").split("\n").filter((line) => line && line[0] !== "#").slice(1)
    .map((line) => line.trim().split(/\s+/).map(Number));
  const points = new Map(rows(".node").map(([id, ...xyz]) => [id, xyz]));
  const faces = new Map(); // from three vertices to the tetrahedra that have them
  const angles = rows(".ele").map(([, ...corners], t) => {
    const p = corners.slice(0, 4).map((v) => points.get(v));
    const minus = (a, b) => a.map((x, i) => x - b[i]);
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const unit = (a) => a.map((x) => x / Math.sqrt(dot(a, a)));
    let least = 180;
    for (let i = 0; i < 4; ++i) {
      for (let j = i + 1; j < 4; ++j) {
        const axis = unit(minus(p[j], p[i]));
        const [u, v] = [0, 1, 2, 3].filter((k) => k !== i && k !== j).map((k) => {
          const arm = minus(p[k], p[i]);
          return unit(arm.map((x, n) => x - axis[n] * dot(arm, axis)));
        });
        least = Math.min(least, (Math.acos(Math.min(1, Math.max(-1, dot(u, v)))) * 180) / Math.PI);
      }
    }
    for (let k = 0; k < 4; ++k) {
      const face = corners.slice(0, 4).filter((_, i) => i !== k).sort((a, b) => a - b).join();
      faces.set(face, [...(faces.get(face) ?? []), t]);
    }
    return least;
  });
  return [...faces.values()].filter((tets) => tets.length === 1).map(([t]) => angles[t]).sort((a, b) => a - b);
}

test("the colours of quality are the smallest dihedral angles of the tetrahedra", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 1280, height: 800 });
  await page.getByText("Quality").click();
  server.stream([0.03]);
  const { revision } = await server.stats();
  const angles = () => page.evaluate(() => {
    const { body } = window.incise.stage;
    const facts = body.mesh.geometry.getAttribute("aFacts").array;
    const positions = body.mesh.geometry.getAttribute("position").array;
    const shown = [];
    for (let slot = 0; slot < body.slots; ++slot) {
      if (positions.subarray(9 * slot, 9 * slot + 9).some((x) => x !== 0)) shown.push((facts[12 * slot + 1] * 45) / 255);
    }
    return shown.sort((a, b) => a - b);
  });
  await until(page, (r) => window.incise.progress.revision === r, revision);
  await server.stop(); // its capture is whole then; the page keeps what it holds
  const base = server.file("state");
  server.incise("export", server.file("session.capture"), "--out", `${base}.node`);
  const wanted = boundaryAngles(base).map((angle) => Math.min(angle, 45));
  let shown = [];
  for (let tries = 0; tries < 300; ++tries) { // the tetrahedra come on a connection of their own, at most 20 times a second
    shown = await angles();
    if (shown.length === wanted.length && shown.every((angle, i) => Math.abs(angle - wanted[i]) < 0.2)) break;
    await page.waitForTimeout(100);
  }
  assert.equal(shown.length, wanted.length);
  shown.forEach((angle, i) => assert.ok(Math.abs(angle - wanted[i]) < 0.2, `face ${i}: ${angle}, wanted ${wanted[i]}`));
  assert.ok(shown[0] < 30 && shown.at(-1) > 40);
  await shot(page, "quality");
  assert.deepEqual(faults, []);
});

test("a drag of the mouse cuts the body in two, a shallow one does not", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  await bladeIsReady(page);
  await page.locator("#depth").fill("0.15");
  await drag(page, [0.66, 0.05], [0.68, 0.92]);
  await until(page, () => window.incise.progress.revision > 0 && !document.body.dataset.stroke);
  await page.waitForTimeout(500);
  assert.equal((await progress(page)).pieces, 1);
  await shot(page, "shallow_cut");
  await page.locator("#depth").fill("1");
  await drag(page, [0.42, 0.02], [0.46, 0.98]);
  await until(page, () => window.incise.progress.pieces >= 2);
  assert.equal((await progress(page)).hashAgrees, true);
  await page.locator("#open").fill("0.6");
  await shot(page, "mouse_cut");
  assert.deepEqual(faults, []);
});

test("a shorter blade does not reach through, and the recording knows how long it was", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  const length = () => page.evaluate(() => Math.hypot(...window.incise.mouse.facts.tip));
  await bladeIsReady(page);
  const whole = await length();
  await page.locator("#length").fill("0.1");
  await until(page, (least) => document.body.dataset.blade === "open" && Math.hypot(...window.incise.mouse.facts.tip) < least, 0.2 * whole);
  await drag(page, [0.42, 0.02], [0.46, 0.98]);
  await until(page, () => window.incise.progress.revision > 0 && !document.body.dataset.stroke);
  await page.waitForTimeout(500);
  assert.equal((await progress(page)).pieces, 1);
  await page.locator("#length").fill("1");
  await until(page, (least) => document.body.dataset.blade === "open" && Math.hypot(...window.incise.mouse.facts.tip) > least, 0.9 * whole);
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

test("the page comes back by itself when the server does", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  server.stream([0.02]);
  await until(page, () => window.incise.progress.pieces >= 2);
  const { revision } = await progress(page);
  const session = await page.evaluate(() => window.incise.facts.session);
  await page.waitForTimeout(400); // the journal's group commit
  await server.stop("SIGKILL");
  await until(page, () => document.getElementById("connection").dataset.stage !== "open");
  await until(page, () => /Trying again|Connecting/.test(document.getElementById("connection-text").textContent));
  await shot(page, "server_away");
  await server.start("--resume");
  await until(page, () => document.getElementById("connection").dataset.stage === "open");
  assert.equal(await page.evaluate(() => window.incise.facts.session), session);
  assert.equal((await progress(page)).revision, revision);
  // A stroke after the restart reaches the same page; so does the state of a server that begins anew.
  await bladeIsReady(page);
  server.stream([-0.03]);
  await until(page, (r) => window.incise.progress.revision > r, revision);
  assert.equal((await progress(page)).hashAgrees, true);
  await server.stop();
  await server.start();
  await until(page, (s) => window.incise.facts.session !== s && window.incise.progress.revision === 0, session);
  assert.equal((await progress(page)).hashAgrees, true);
  // A line that breaks without a word.
  await page.evaluate(() => window.incise.send({ kind: "drop" }));
  await until(page, () => document.getElementById("connection").dataset.stage === "open");
  assert.deepEqual(faults, []);
});

test("a second window is told who holds the blade, and can take it", async (t) => {
  const server = await serve(t);
  const first = await look(t, server.url);
  await bladeIsReady(first.page);
  const second = await look(t, server.url);
  await second.page.getByText("another window's hand").waitFor();
  await shot(second.page, "blade_taken");
  await second.page.getByRole("button", { name: "Take it over" }).click();
  await bladeIsReady(second.page);
  await first.page.getByText("Another window has taken the blade").waitFor();
  await first.page.close();
  assert.deepEqual([...first.faults, ...second.faults], []);
});

test("reset gives everybody a fresh body", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  server.stream([0.02]);
  await until(page, () => window.incise.progress.pieces >= 2);
  await page.getByRole("button", { name: "Reset" }).click();
  await page.locator("#reset-dialog").getByRole("button", { name: "Reset" }).click();
  await until(page, () => window.incise.progress.revision === 0 && window.incise.progress.pieces === 1);
  assert.equal((await progress(page)).hashAgrees, true);
  // The blade is still in hand.
  await bladeIsReady(page);
  await drag(page, [0.42, 0.02], [0.46, 0.98]);
  await until(page, () => window.incise.progress.pieces >= 2);
  assert.deepEqual(faults, []);
});

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
  const scrub = (revision) => page.locator("#scrub").evaluate((e, r) => {
    e.valueAsNumber = r;
    e.dispatchEvent(new Event("change"));
  }, revision);
  await scrub(recorded.revision);
  await until(page, (r) => window.incise.progress.revision === r, recorded.revision);
  assert.equal((await progress(page)).hash, recorded.state_hash);
  assert.equal((await progress(page)).pieces, 3);
  await shot(page, "replay");
  await scrub(2);
  await until(page, () => window.incise.progress.revision === 2);
  await page.getByRole("button", { name: "One batch on" }).click();
  await until(page, () => window.incise.progress.revision === 3);
  await page.locator("#speed").selectOption("16");
  await page.getByRole("button", { name: "Play" }).click();
  await until(page, (r) => window.incise.progress.revision === r, recorded.revision);
  assert.equal((await progress(page)).hash, recorded.state_hash);
  assert.equal((await server.stats()).revision, 0);
  await page.getByRole("button", { name: "Back to live" }).click();
  await until(page, () => window.incise.replay.facts === null && window.incise.progress.revision === 0);
  assert.equal((await progress(page)).hashAgrees, true);
  assert.deepEqual(faults, []);
});

test("a server with tokens asks for one", async (t) => {
  const server = new Server();
  t.after(() => server.end());
  server.config.listen = { token_file: server.file("tokens.json", JSON.stringify([
    { token: "only-for-watching", roles: ["viewer"] }, { token: "for-cutting-as-well", roles: ["viewer", "operator", "admin"] }])) };
  server.config.capture = { library: "captures" };
  mkdirSync(server.file("captures"));
  writeFileSync(server.file("captures/last week.capture"), "");
  await server.start();
  const context = await browser.newContext();
  t.after(() => context.close());
  const page = await context.newPage();
  await page.goto(server.url);
  await page.locator("#token-dialog[open]").waitFor();
  assert.equal((await fetch(server.url + "captures")).status, 401);
  await page.locator("#token").fill("only-for-watching");
  await page.getByRole("button", { name: "Continue" }).click();
  await until(page, () => window.incise.progress);
  // What the page asks for beside the stream comes by the same token.
  await until(page, () => document.querySelector("#captures")?.textContent === "last week");
  const figures = page.waitForEvent("popup");
  await page.evaluate(() => document.querySelector(".links a[href=stats]").click());
  await (await figures).getByText("\"wrong_tokens\":0").waitFor();
  await page.getByText("you need an operator's token").waitFor();
  await page.getByRole("button", { name: "Enter a token" }).first().click();
  await page.locator("#token").fill("for-cutting-as-well");
  await page.getByRole("button", { name: "Continue" }).click();
  await bladeIsReady(page);
});

test("everything is reached by keyboard and has a name", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { colorScheme: "light", width: 1280, height: 800 });
  await until(page, () => window.incise.stage.framesDrawn > 0);
  await shot(page, "loaded_light");
  const nameless = await page.evaluate(() => [...document.querySelectorAll("button, input, select, a, [role=img]")]
    .filter((e) => !(e.getAttribute("aria-label") || e.labels?.[0]?.textContent.trim() || e.textContent.trim()))
    .map((e) => e.outerHTML));
  assert.deepEqual(nameless, []);
  const before = await page.evaluate(() => window.incise.stage.camera.position.toArray());
  await page.locator("#picture").focus();
  await page.keyboard.press("ArrowLeft");
  assert.notDeepEqual(await page.evaluate(() => window.incise.stage.camera.position.toArray()), before);
  await page.keyboard.press("t");
  assert.equal(await page.evaluate(() => window.incise.tool), "turn");
  await page.keyboard.press("[");
  assert.notEqual(await page.textContent("#depth-text"), "through");
  await page.keyboard.press("w");
  assert.equal(await page.isChecked("#wire"), true);
  await page.getByText("Quality").click();
  await page.keyboard.press("s");
  await shot(page, "wire_quality_section");
  // Each pass of the Tab key lands on something new, until all have been seen.
  const seen = new Set();
  for (let i = 0; i < 30; ++i) {
    await page.keyboard.press("Tab");
    seen.add(await page.evaluate(() => document.activeElement.id || document.activeElement.textContent));
  }
  for (const id of ["theme", "panel-toggle", "wire", "depth", "length", "tilt", "open", "fit", "reset"]) assert.ok(seen.has(id), id);
  assert.deepEqual(faults, []);
});

test("a phone shows it all, and a finger cuts", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 390, height: 780, hasTouch: true, isMobile: true });
  await bladeIsReady(page);
  const wide = await page.evaluate(() => document.documentElement.scrollWidth);
  assert.ok(wide <= 390, `${wide} px wide`);
  const cdp = await page.context().newCDPSession(page);
  const finger = (type, y) => cdp.send("Input.dispatchTouchEvent", { type, touchPoints: type === "touchEnd" ? [] : [{ x: 180 + y / 40, y }] });
  await finger("touchStart", 170);
  for (let y = 180; y <= 560; y += 12) {
    await finger("touchMove", y);
    await page.waitForTimeout(10);
  }
  await finger("touchEnd");
  await until(page, () => window.incise.progress.pieces >= 2);
  await page.waitForTimeout(500);
  await shot(page, "phone");
  await page.locator("#panel-toggle").click();
  await shot(page, "phone_panel");
  assert.deepEqual(faults, []);
});

test("memory stays flat over many deltas", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 320, height: 240 });
  const cdp = await page.context().newCDPSession(page);
  const used = async () => {
    await cdp.send("HeapProfiler.collectGarbage");
    return (await cdp.send("Runtime.getHeapUsage")).usedSize;
  };
  const pass = (i) => server.stream([-0.09 + 0.012 * i], { speed: 0, lines: 300 });
  for (let i = 0; i < 4; ++i) pass(i);
  const warm = await used();
  for (let i = 4; i < 12; ++i) pass(i);
  const { revision } = await server.stats();
  await until(page, (r) => window.incise.progress.revision === r, revision);
  assert.equal((await progress(page)).hashAgrees, true);
  const then = await used();
  assert.ok(then < warm + 6e6, `${warm} bytes, then ${then} after ${revision} deltas`);
  assert.deepEqual(faults, []);
});
