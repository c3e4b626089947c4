// The viewer page and the stream, in a real browser against a real server.

import assert from "node:assert/strict";
import { mkdirSync, writeFileSync } from "node:fs";
import { test } from "node:test";
import { atRevision, bladeIsReady, drag, look, notices, serve, shot, theBrowser } from "./page.mjs";
import { damageOneDelta } from "./damage.mjs";
import { progress, Server, until } from "./server.mjs";
import { boundaryOfVtu, canonical } from "./triangles.mjs";

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

test("a change that was damaged on its way turns the light red, and the page loads the state again", async (t) => {
  const server = await serve(t);
  const damage = await damageOneDelta(t, server);
  const { page, faults } = await look(t, damage.url);
  await page.evaluate(() => {
    const row = document.getElementById("hash-row");
    const shown = (window.lights = [row.dataset.agrees]);
    new MutationObserver(() => shown.push(row.dataset.agrees)).observe(row, { attributeFilter: ["data-agrees"] });
  });
  damage.arm();
  server.stream([0.03]);
  await atRevision(page, (await server.stats()).revision);
  await until(page, () => window.incise.progress.hashAgrees);
  assert.equal(damage.done(), true);
  const lights = await page.evaluate(() => window.lights);
  assert.ok(lights.includes("false"), lights.join());
  assert.equal(lights.at(-1), "true");
  const shown = await page.evaluate(async () => Array.from(await window.incise.dump()));
  await server.stop();
  server.incise("export", server.file("session.capture"), "--out", server.file("end.vtu"));
  assert.deepEqual(canonical(Float32Array.from(shown)), canonical(boundaryOfVtu(server.file("end.vtu"))));
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
  // A stroke after the restart reaches the same page; so does the state of a server that starts without --resume.
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

test("pose to pixel is measured where a pose is behind the picture, and nowhere else", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 1280, height: 800 });
  await until(page, () => window.incise.stage.framesDrawn > 0);
  server.stream([0.03]);
  await atRevision(page, (await server.stats()).revision);
  await until(page, () => /\d ms$/.test(document.getElementById("latency").textContent));
  await until(page, () => window.incise.stage.atRest);
  await until(page, () => document.getElementById("latency").textContent === "–"); // the poses have ended
  // Other colours are a change of the picture that no pose is behind.
  const qualities = () =>
    page.evaluate(() =>
      window.incise.stage.body.mesh.geometry.getAttribute("aFacts").array.reduce((sum, x) => sum + x, 0),
    );
  const before = await qualities();
  await page.getByText("Quality").click();
  while ((await qualities()) === before) await page.waitForTimeout(50);
  await until(page, () => window.incise.stage.atRest);
  await page.waitForTimeout(1200); // two turns of the figures: a measurement would be shown
  assert.equal(await page.textContent("#latency"), "–");
  assert.deepEqual(faults, []);
});

test("a frozen server is noticed while it is still connected, and nothing is cut blindly", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  await bladeIsReady(page);
  await page.evaluate(() => {
    const stages = (window.stages = [document.getElementById("connection").dataset.stage]);
    new MutationObserver(() => stages.push(document.getElementById("connection").dataset.stage)).observe(
      document.getElementById("connection"),
      { attributeFilter: ["data-stage"] },
    );
  });
  server.process.kill("SIGSTOP");
  await until(page, () => document.getElementById("connection").dataset.stage !== "open");
  assert.equal(await page.textContent("#connection-text"), "The server does not answer.");
  await drag(page, [0.42, 0.3], [0.46, 0.98]);
  await shot(page, "server_frozen");
  assert.ok((await notices(page)).some((text) => text.includes("Nothing is cut until it does")));
  server.process.kill("SIGCONT");
  await until(
    page,
    () => document.getElementById("connection").dataset.stage === "open" && document.body.dataset.blade === "open",
  );
  assert.deepEqual(
    (await page.evaluate(() => window.stages)).filter((stage, i, all) => stage !== all[i - 1]),
    ["open", "stalled", "open"],
  );
  // The next stroke is the first that the server gets.
  await drag(page, [0.62, 0.02], [0.64, 0.98]);
  await until(page, () => window.incise.progress.pieces >= 2);
  assert.equal((await server.stats()).strokes, 1);
  assert.deepEqual(faults, []);
});

test("who cuts while somebody else resets the body is told why it is whole again", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  await bladeIsReady(page);
  await drag(page, [0.42, 0.02], [0.46, 0.98]);
  await until(page, () => window.incise.progress.pieces >= 2);
  const session = await page.evaluate(() => window.incise.facts.session);
  server.streamPasses(
    [
      [
        [0.02, -0.12, 0.07],
        [0.02, 0.12, 0.07],
      ],
    ],
    { more: ["--reset"] },
  );
  await until(page, (s) => window.incise.facts.session !== s, session);
  assert.ok((await notices(page)).some((text) => text.includes("was reset")));
  await atRevision(page, (await server.stats()).revision);
  assert.equal((await progress(page)).pieces, 2); // not three: the mouse's cut is gone
  assert.equal((await progress(page)).hashAgrees, true);
  assert.deepEqual(faults, []);
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
  assert.ok(!(await notices(page)).some((text) => text.includes("was reset"))); // who asked for it knows
  // The blade is still in hand.
  await bladeIsReady(page);
  await drag(page, [0.42, 0.02], [0.46, 0.98]);
  await until(page, () => window.incise.progress.pieces >= 2);
  assert.deepEqual(faults, []);
});

test("undo goes back one stroke at a time, with the button and with the key", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  const undo = page.getByRole("button", { name: "Undo" });
  await bladeIsReady(page);
  assert.equal(await undo.isDisabled(), true);
  const hashes = [(await progress(page)).hash];
  for (const x of [0.4, 0.55]) {
    await drag(page, [x, 0.02], [x + 0.04, 0.98]);
    await until(page, (h) => window.incise.progress.hash !== h && !document.body.dataset.stroke, hashes.at(-1));
    await atRevision(page, (await server.stats()).revision);
    hashes.push((await progress(page)).hash);
  }
  await undo.click();
  await until(page, (h) => window.incise.progress.hash === h, hashes[1]);
  await shot(page, "undone");
  await page.keyboard.press("Control+z");
  await until(page, (h) => window.incise.progress.hash === h, hashes[0]);
  await until(page, () => document.getElementById("undo").disabled);
  assert.deepEqual(await notices(page), []);
  // The blade is still in hand.
  await bladeIsReady(page);
  await drag(page, [0.42, 0.02], [0.46, 0.98]);
  await until(page, () => window.incise.progress.pieces >= 2);
  assert.deepEqual(faults, []);
});

test("an undo that is asked for within a stroke says that it waits for its end, and takes it back", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  await bladeIsReady(page);
  const uncut = (await progress(page)).hash;
  const key = setTimeout(() => void page.keyboard.press("z"), 200);
  t.after(() => clearTimeout(key));
  await drag(page, [0.4, 0.02], [0.44, 0.98], 60);
  await until(page, () => window.incise.progress.revision > 0 || document.querySelector(".notice p"));
  assert.deepEqual(await notices(page), [
    "The undo waits until this stroke ends, and takes it back where it has cut something.",
  ]);
  await until(page, (h) => window.incise.progress.hash === h && !document.body.dataset.stroke, uncut);
  assert.deepEqual(faults, []);
});

test("a server with tokens asks for one", async (t) => {
  const server = new Server();
  t.after(() => server.end());
  server.config.listen = {
    token_file: server.file(
      "tokens.json",
      JSON.stringify([
        { token: "only-for-watching", roles: ["viewer"] },
        { token: "for-cutting-as-well", roles: ["viewer", "operator", "admin"] },
      ]),
    ),
  };
  server.config.capture = { library: "captures" };
  mkdirSync(server.file("captures"));
  writeFileSync(server.file("captures/last week.capture"), "");
  await server.start();
  const context = await theBrowser().newContext();
  t.after(() => context.close());
  const page = await context.newPage();
  await page.goto(server.url);
  await page.locator("#token-dialog[open]").waitFor();
  assert.equal((await fetch(`${server.url}captures`)).status, 401);
  // Who does not give one can change their mind; a wrong one is called wrong; Enter sends it.
  await page.getByRole("button", { name: "Not now" }).click();
  await page.getByRole("button", { name: "Enter a token" }).click();
  await page.locator("#token").fill("not-one-of-the-tokens");
  await page.keyboard.press("Enter");
  await page.getByText("did not accept that token").waitFor();
  await page.locator("#token").fill("only-for-watching");
  await page.keyboard.press("Enter");
  await until(page, () => window.incise.progress);
  // What the page fetches apart from the stream uses the same token.
  await until(page, () => document.querySelector("#captures")?.textContent === "last week");
  const figures = page.waitForEvent("popup");
  await page.evaluate(() => document.querySelector(".links a[href=stats]").click());
  await (await figures).getByText('"wrong_tokens":2').waitFor();
  await page.getByText("you need an operator's token").waitFor();
  await page.getByRole("button", { name: "Enter a token" }).first().click();
  await page.locator("#token").fill("for-cutting-as-well");
  await page.getByRole("button", { name: "Continue" }).click();
  await bladeIsReady(page);
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
