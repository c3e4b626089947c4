// What a user does beside cutting: saves what is seen, looks from elsewhere, measures, sees where the blade would enter.

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { copyFileSync, readFileSync, renameSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { atRevision, bladeIsReady, drag, look, serve, shot } from "./page.mjs";
import { bin, until } from "./server.mjs";

/** The file that a click on this button saves: [name, bytes]. */
async function savedBy(page, id) {
  const download = page.waitForEvent("download");
  await page.evaluate((id) => document.getElementById(id).click(), id);
  const file = await download;
  return [file.suggestedFilename(), readFileSync(await file.path())];
}

const atRest = (page) => until(page, () => window.incise.stage.atRest);

test("a saved picture is what is seen, at the screen's resolution also while something moves", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 1280, height: 720 });
  await atRest(page);
  server.stream([0.03]);
  const { revision } = await server.stats();
  await atRevision(page, revision);
  const [name, png] = await savedBy(page, "save-picture");
  assert.equal(name, `liver_r${revision}.png`);
  assert.equal(png.subarray(1, 4).toString(), "PNG");
  assert.ok(png.readUInt32BE(16) >= 1280 && png.readUInt32BE(20) >= 720);
  const [glbName, glb] = await savedBy(page, "save-glb");
  assert.deepEqual([glbName, glb.subarray(0, 4).toString()], [`liver_r${revision}.glb`, "glTF"]);
  // While the body turns fewer pixels are drawn.
  const moving = await page.evaluate(
    () =>
      new Promise((resolve) => {
        const { stage } = window.incise;
        const turn = async () => {
          stage.turn(0.5, 0);
          if (stage.renderer.getPixelRatio() >= 1) return requestAnimationFrame(turn);
          const shown = stage.colourAt(0.5, 0.5);
          const bitmap = await createImageBitmap(await stage.picture());
          const pen = new OffscreenCanvas(bitmap.width, bitmap.height).getContext("2d");
          pen.drawImage(bitmap, 0, 0);
          const saved = [...pen.getImageData(bitmap.width / 2, bitmap.height / 2, 1, 1).data];
          resolve({ width: bitmap.width, height: bitmap.height, shown, saved });
        };
        turn();
      }),
  );
  assert.ok(moving.width >= 1280 && moving.height >= 720, `${moving.width} x ${moving.height}`);
  for (const k of [0, 1, 2]) assert.ok(Math.abs(moving.saved[k] - moving.shown[k]) < 40, JSON.stringify(moving));
  assert.ok(moving.saved[0] > 1.5 * moving.saved[2], "the body is in it");
  assert.deepEqual(faults, []);
});

test("number keys and the menu look at the whole body from the standard sides", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 1280, height: 720 });
  await atRest(page);
  const direction = () =>
    page.evaluate(() => {
      const arm = window.incise.stage.toEye;
      return arm.map((x) => Math.round((100 * x) / Math.hypot(...arm)) / 100 + 0);
    });
  const sides = [
    [0, -1, 0],
    [0, 1, 0],
    [-1, 0, 0],
    [1, 0, 0],
    [0, 0, 1],
    [0, 0, -1],
    [0.58, -0.58, 0.58],
  ];
  for (const [i, side] of sides.entries()) {
    await page.keyboard.press(String(i + 1));
    assert.deepEqual(await direction(), side, `key ${i + 1}`);
    assert.ok(await page.evaluate(() => window.incise.stage.colourAt(0.39, 0.47)[0] > 40), `key ${i + 1}: the body`);
  }
  await shot(page, "view_isometric");
  await page.keyboard.press("f");
  assert.deepEqual(await direction(), [-0.18, -0.62, 0.76]);
  await page.locator("#more summary").click();
  await shot(page, "more_menu");
  await page.locator("#views").getByText("Left").click();
  assert.deepEqual(await direction(), sides[2]);
  await page.keyboard.press("Escape");
  assert.equal(await page.locator("#more > div").isVisible(), false);
  await page.setViewportSize({ width: 390, height: 844 });
  // The panel would cover the tools: it closes as the window becomes so narrow.
  await until(page, () => document.body.dataset.panel === "closed");
  await page.locator("#more summary").click();
  await shot(page, "more_menu_phone");
  const box = await page.locator("#more > div").boundingBox();
  assert.ok(box.x >= 0 && box.y >= 0 && box.x + box.width <= 390 && box.y + box.height <= 844, JSON.stringify(box));
  await page.mouse.click(195, 150);
  assert.equal(await page.locator("#more > div").isVisible(), false);
  assert.deepEqual(faults, []);
});

test("the address keeps the view when it comes to rest, and a link shows it again", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 1280, height: 720 });
  await atRest(page);
  const entries = await page.evaluate(() => history.length);
  await page.keyboard.press("3");
  await page.keyboard.press("+");
  await page.locator("#colouring").getByText("Pieces").click();
  await page.locator("#theme").click();
  await page.keyboard.press("s");
  await page.locator("#section-at").fill("0.4");
  await until(
    page,
    () => window.incise.stage.atRest && /section=-1,0,0,0.4&colours=pieces&theme=light$/.test(location.hash),
  );
  assert.equal(await page.evaluate(() => history.length), entries);
  const view = (of) =>
    of.evaluate(() => {
      const { stage, look } = window.incise;
      const { position, target } = stage.cameraPlace;
      return { at: [...position, ...target].map((x) => Math.round(x * 1e4)), ...look.state };
    });
  const kept = await view(page);
  const url = page.url();
  const other = await look(t, url, { width: 1280, height: 720 });
  await atRest(other.page);
  assert.deepEqual(await view(other.page), kept);
  assert.equal(await other.page.isChecked("#section"), true);
  assert.equal(
    await other.page.evaluate(() => localStorage.getItem("incise-theme")),
    null,
    "not the user's own choice",
  );
  await shot(other.page, "linked_view");
  // Another link in the same page; then one that makes no sense, and one of another body.
  await other.page.evaluate(() => (location.hash = "#body=liver&from=0,-1,0&to=0,0,0&theme=dark"));
  await until(other.page, () => Math.abs(window.incise.stage.cameraPlace.position[1] + 1) < 1e-6);
  assert.equal(await other.page.isChecked("#section"), false);
  const before = await view(other.page);
  for (const bad of ["#%%%&from=1,2&to=x", "#body=heart&from=0,9,0&to=0,0,0", "#from=NaN,0,0&to=0,0,0&section=w,1,2"]) {
    await other.page.evaluate((bad) => (location.hash = bad), bad);
    await until(other.page, (bad) => window.incise.stage.atRest && location.hash !== bad, bad);
    assert.deepEqual(await view(other.page), before, bad);
  }
  await until(other.page, () => /shows another body, heart/.test(document.getElementById("notices").textContent));
  // One that names no body is for any.
  await other.page.evaluate(() => (location.hash = "#from=0,-1.5,0&to=0,0,0"));
  await until(other.page, () => Math.abs(window.incise.stage.cameraPlace.position[1] + 1.5) < 1e-6);
  assert.deepEqual([...faults, ...other.faults], []);
});

test("clicks measure lengths and areas of cuts, on the surface that is seen", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  await atRest(page);
  await page.keyboard.press("5"); // from above
  await page.keyboard.press("m");
  const spots = [
    [360, 240],
    [430, 260],
    [410, 290],
  ];
  /** The length of the line through the body's skin below these spots of the page. */
  const lengthOf = (spots) =>
    page.evaluate((spots) => {
      const { stage } = window.incise;
      const Vector3 = stage.centre.constructor;
      const at = spots.map(([x, y]) => {
        const far = new Vector3((2 * x) / innerWidth - 1, 1 - (2 * y) / innerHeight, 0.5).unproject(stage.camera);
        const way = far.sub(stage.camera.position).normalize();
        return stage.camera.position.clone().addScaledVector(way, stage.body.raycast(stage.camera.position, way));
      });
      return 1000 * at.slice(1).reduce((sum, p, i) => sum + p.distanceTo(at[i]), 0);
    }, spots);
  const labels = () => page.evaluate(() => window.incise.measure.labels);
  /** How many pixels of a saved picture have the marks' colour. */
  const marksIn = () =>
    page.evaluate(async () => {
      const picture = await createImageBitmap(await window.incise.stage.picture());
      const pen = new OffscreenCanvas(picture.width, picture.height).getContext("2d");
      pen.drawImage(picture, 0, 0);
      const { data } = pen.getImageData(0, 0, picture.width, picture.height);
      let n = 0;
      for (let i = 0; i < data.length; i += 4) if (data[i + 1] > data[i] + 60) ++n;
      return n;
    });
  const clicks = async (spots) => {
    for (const spot of spots) await page.mouse.click(...spot);
  };
  await clicks(spots.slice(0, 2));
  const straight = await lengthOf(spots.slice(0, 2));
  assert.ok(straight > 5);
  const [first] = await labels();
  assert.match(first, /^[\d.]+ mm$/);
  assert.ok(Math.abs(parseFloat(first) - straight) < 0.2, `${first}, wanted ${straight}`);
  await clicks(spots.slice(2));
  const total = await lengthOf(spots);
  assert.ok(Math.abs(parseFloat((await labels())[0]) - total) < 0.2, `${await labels()}, wanted ${total}`);
  await page.mouse.click(20, 400); // beside the body
  assert.ok(Math.abs(parseFloat((await labels())[0]) - total) < 0.2);
  await shot(page, "measure_dark");
  await page.keyboard.press("l");
  await shot(page, "measure_light");
  assert.ok((await marksIn()) > 100);
  // A drag turns, and measures nothing.
  await page.mouse.move(450, 350);
  await page.mouse.down();
  await page.mouse.move(500, 300, { steps: 4 });
  await page.mouse.up();
  assert.ok(Math.abs(parseFloat((await labels())[0]) - total) < 0.2);
  // Escape ends it, also in the midst of a click, and gives back the tool from before; a picture shows no marks then, nor the blade's preview.
  await page.mouse.move(...spots[0]);
  await page.mouse.down();
  await page.keyboard.press("Escape");
  await page.mouse.up();
  assert.deepEqual(await labels(), []);
  assert.equal(await page.evaluate(() => window.incise.measure.shown), false);
  assert.equal(await page.evaluate(() => window.incise.tool), "cut");
  await page.mouse.move(...spots[1]);
  assert.ok(await page.evaluate(() => window.incise.mouse.preview() !== null));
  assert.equal(await marksIn(), 0);

  // The side of a cut that is clicked has the area of the cut.
  server.stream([0.03]);
  await atRevision(page, (await server.stats()).revision);
  await page.locator("#open").fill("1");
  await page.keyboard.press("7");
  await page.keyboard.press("m");
  const findCut = () => {
    const { stage } = window.incise;
    stage.colourAt(0.5, 0.5); // draws: the camera has moved
    const { slots, corners, isCut } = stage.body.shown(stage.openNow);
    const p = new Float64Array(9);
    for (let slot = 0; slot < slots; ++slot) {
      if (!corners(slot, p) || !isCut(slot)) continue;
      const middle = stage.centre.clone().set(...[0, 1, 2].map((k) => (p[k] + p[k + 3] + p[k + 6]) / 3));
      const { x, y } = middle.project(stage.camera);
      if (stage.pick(x, y)?.slot === slot) return [((x + 1) / 2) * innerWidth, ((1 - y) / 2) * innerHeight];
    }
    return null;
  };
  await until(page, findCut); // the cut opens in a while
  const cut = await page.evaluate(findCut);
  await page.mouse.click(...cut);
  await until(page, () => /cm²$/.test(window.incise.measure.labels.at(-1)));
  await shot(page, "measure_cut");
  const area = parseFloat((await labels()).at(-1));
  const all = parseFloat(await page.textContent("#cut-area"));
  assert.ok(Math.abs(area - all) < 0.06, `${area}, and all cuts ${all} cm²`);
  assert.deepEqual(faults, []);
});

test("the blade is shown where it would enter, before the button is pressed", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 1280, height: 720 });
  await bladeIsReady(page);
  await atRest(page);
  const frames = await page.evaluate(() => window.incise.stage.framesDrawn);
  const preview = () =>
    page.evaluate(() => {
      const { stage, mouse } = window.incise;
      const shown = mouse.preview();
      if (!shown) return null;
      const { entry, tip } = shown;
      const { canvas } = stage.marks;
      const at = entry.clone().project(stage.camera);
      const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
      copy.drawImage(canvas, 0, 0);
      const pixels = copy.getImageData(0, 0, canvas.width, canvas.height).data;
      const x = ((at.x + 1) / 2) * innerWidth,
        y = ((1 - at.y) / 2) * innerHeight;
      return { x, y, below_mm: 1000 * tip.distanceTo(entry), drawn: pixels.filter((p) => p > 0).length };
    });
  await page.locator("#depth").fill("0.3");
  const depth_mm = parseFloat(await page.textContent("#depth-text"));
  await page.mouse.move(520, 330);
  const straight = await preview();
  assert.ok(Math.hypot(straight.x - 520, straight.y - 330) < 1, JSON.stringify(straight));
  assert.ok(Math.abs(straight.below_mm - depth_mm) < 1, JSON.stringify(straight));
  assert.ok(straight.drawn > 100);
  assert.equal(
    await page.evaluate(() => window.incise.stage.framesDrawn),
    frames,
    "the body is not drawn again for it",
  );
  await page.locator("#tilt").fill("40");
  await shot(page, "blade_preview");
  assert.ok(Math.abs((await preview()).below_mm - depth_mm) < 1);
  await page.mouse.move(20, 400); // beside the body
  assert.equal(await preview(), null);
  await page.mouse.move(520, 330);
  await page.mouse.down();
  assert.equal(await preview(), null);
  await page.mouse.up();
  await page.keyboard.press("t");
  await page.mouse.move(521, 330);
  assert.equal(await preview(), null, "it cannot cut now");
  assert.deepEqual(faults, []);
});

test("what a section hides has no preview and is not cut", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 1280, height: 720 });
  await bladeIsReady(page);
  await page.keyboard.press("5"); // from above
  await page.keyboard.press("s");
  await page.locator("#section-axis").getByText("X").click();
  await atRest(page);
  /** Where a place is seen that is this far from the body's middle along each axis, in shares of its size, on the side that is hidden. */
  const placeAt = (x, y, hidden) =>
    page.evaluate(
      ([x, y, hidden]) => {
        const { stage } = window.incise;
        const place = stage.centre.clone();
        place.x += x * stage.bodySize_m * stage.plane[0] * (hidden ? 1 : -1);
        place.y += y * stage.bodySize_m;
        return stage.marks.onScreen(place);
      },
      [x, y, hidden],
    );
  const preview = async (hidden) => {
    await page.mouse.move(...(await placeAt(0.15, 0, hidden)));
    return page.evaluate(() => window.incise.mouse.preview() !== null);
  };
  const dragAt = async (hidden) => {
    const [from, to] = [await placeAt(0.15, -0.35, hidden), await placeAt(0.15, 0.35, hidden)];
    await page.mouse.move(...from);
    await page.mouse.down();
    await page.mouse.move(...to, { steps: 20 });
    await page.mouse.up();
  };
  assert.deepEqual([await preview(true), await preview(false)], [false, true]);
  await dragAt(true);
  await until(page, () => /cut nothing/.test(document.getElementById("notices").textContent));
  assert.equal((await server.stats()).revision, 0);
  // Right through from the section's face: not the half before it.
  await page.locator("#section-axis").getByText("Z").click();
  await dragAt(false);
  await until(page, () => window.incise.progress.revision > 0 && !document.body.dataset.stroke);
  await page.waitForTimeout(500);
  const above_m = await page.evaluate(() => {
    const { stage } = window.incise;
    const { slots, corners, isCut } = stage.body.shown(0);
    const p = new Float64Array(9);
    let above = -Infinity;
    for (let slot = 0; slot < slots; ++slot)
      if (corners(slot, p) && isCut(slot)) above = Math.max(above, p[2], p[5], p[8]);
    return above - stage.plane[3];
  });
  assert.ok(above_m < 0.002, `a cut goes ${above_m} m beyond the plane`);
  await shot(page, "section_cut");
  assert.deepEqual(faults, []);
});

test("marks and preview are gone from the screen when they are over", async (t) => {
  const server = await serve(t, { capture: { path: "first.capture", library: "." } });
  server.stream([0.03]);
  await server.stop();
  renameSync(server.file("first.capture"), server.file("old.capture"));
  await server.start();
  server.stream([0.03]);
  const { page, faults } = await look(t, server.url, { width: 1280, height: 720 });
  await bladeIsReady(page);
  await page.locator("#open").fill("1");
  await page.mouse.move(1200, 300); // the panel
  await until(page, () => window.incise.stage.bladesShown === 0 && window.incise.stage.atRest);
  const seen = () => page.screenshot({ clip: { x: 150, y: 100, width: 700, height: 450 } }); // what the canvas holds may differ
  const bare = await seen();
  for (let i = 0; i < 3; ++i) {
    await page.mouse.move(400 + 10 * i, 330);
    await page.mouse.move(300, 330);
    assert.ok(!bare.equals(await seen()), "a preview");
    await page.mouse.move(1200, 300);
    assert.ok(bare.equals(await seen()), "the preview is over");
    await page.keyboard.press("m");
    await page.mouse.click(400 + 10 * i, 330);
    await page.mouse.click(300, 330);
    await page.mouse.move(1200, 300);
    assert.ok(!bare.equals(await seen()), "a measurement");
    await page.keyboard.press("Escape");
    await atRest(page);
    assert.ok(bare.equals(await seen()), "the measurement is over");
  }
  // It is of the live body, not of a replay's.
  await page.keyboard.press("m");
  await page.mouse.click(400, 330);
  await page.mouse.click(300, 330);
  assert.equal(await page.evaluate(() => window.incise.measure.labels.length > 0), true);
  await page.evaluate(() => window.incise.send({ kind: "replay", action: "open", capture: "old.capture", speed: 1 }));
  await until(page, () => document.body.dataset.replay === "on");
  assert.deepEqual(await page.evaluate(() => [window.incise.measure.shown, ...window.incise.measure.labels]), [false]);
  assert.deepEqual(faults, []);
});

test("strokes of several hands are bars and blades of their own colour, with the names that they have", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 1280, height: 800 });
  await bladeIsReady(page);
  await atRest(page);
  /** The server has cut what it was sent, and the page shows it. */
  const settled = async () => {
    for (let last = -1; ; ) {
      const { revision, backlog } = await server.stats();
      if (revision === last && backlog.segments === 0) return atRevision(page, revision);
      last = revision;
      await page.waitForTimeout(300);
    }
  };
  assert.equal(await page.locator("#live-strokes").isVisible(), false);
  server.streamPasses(
    [
      [
        [0.03, -0.12, 0.07],
        [0.03, 0.12, 0.07],
      ],
    ],
    { more: ["--source", "assistant"] },
  );
  await atRevision(page, (await server.stats()).revision);
  const before = await page.evaluate(() => window.incise.progress.revision);
  await drag(page, [0.3, 0.2], [0.36, 0.85]);
  await until(page, (r) => window.incise.progress.revision > r && !document.body.dataset.stroke, before);
  await settled();
  const strokes = () => page.evaluate(() => window.incise.live.strokes);
  const [other, own, ...more] = await strokes();
  assert.deepEqual([other.own, own.own, more.length], [false, true, 0]);
  assert.notEqual(own.source, other.source);
  assert.ok(other.cutArea_m2 > 1e-4 && other.first === 1 && other.last === before);
  assert.deepEqual([own.first, own.last], [before + 1, (await server.stats()).revision]);
  await until(page, () => document.getElementById("blades").textContent === "assistantmouse (you)");
  // The other's blade is seen for a while, in its colour and with its name.
  await page.evaluate((bar) => window.incise.stage.blade(bar.source, false).move([0, 0, 0.1], [0, 0, 0], true), other);
  await page.evaluate(() => window.incise.stage.draw());
  await shot(page, "blades_named");
  const colours = await page.evaluate(() => [...document.querySelectorAll("#blades i")].map((i) => i.style.background));
  assert.equal(new Set(colours).size, 2);
  // A click on a bar shows its figures in the panel, another takes them away.
  const text = () => page.locator("#stroke-text").textContent();
  const bars = await page.locator("#live-timeline").boundingBox();
  await page.mouse.click(bars.x + 4, bars.y + 4);
  assert.match(await text(), /^Stroke of assistant: [\d.]+ s, [\d.]+ cm² when it was cut, revisions 1 to /);
  await shot(page, "stroke_figures");
  await page.mouse.click(bars.x + 4, bars.y + 4);
  assert.equal(await text(), "");
  await page.mouse.click(bars.x + bars.width - 4, bars.y + 16);
  assert.match(await text(), /^Your stroke: /);
  // Undone, the last stroke is no longer there; reset, none is.
  await page.keyboard.press("z");
  await until(page, () => window.incise.live.strokes.length === 1);
  assert.equal((await strokes())[0].own, false);
  await until(page, () => document.getElementById("stroke-text").hidden);
  await page.keyboard.press("r");
  await page.getByRole("button", { name: "Reset" }).last().click();
  await until(page, () => window.incise.progress.revision === 0);
  await until(page, () => document.getElementById("live-strokes").hidden);
  assert.deepEqual(faults, []);
});

test("a mesh that is dropped on the page changes nothing, and the configuration that it offers is one for incised", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url);
  await atRest(page);
  server.incise("phantom", "slab", "--size", 500, "--out", server.file("ball.stl"));
  const drop = (name) =>
    page.evaluate((name) => {
      const data = new DataTransfer();
      data.items.add(new File(["solid"], name));
      for (const type of ["dragover", "drop"]) {
        const event = new DragEvent(type, { dataTransfer: data, bubbles: true, cancelable: true });
        document.getElementById("picture").dispatchEvent(event);
        if (!event.defaultPrevented) return "the browser would leave the page";
      }
      return [...document.querySelectorAll(".notice p")].at(-1).textContent;
    }, name);
  assert.match(await drop("ball.stl"), /^ball\.stl is not opened here.*incised --config "ball\.json"/);
  await shot(page, "dropped");
  const download = page.waitForEvent("download");
  await page.getByRole("button", { name: "Save it" }).click();
  const file = await download;
  assert.equal(file.suggestedFilename(), "ball.json");
  copyFileSync(await file.path(), server.file("ball.json"));
  const checked = spawnSync(join(bin, "incised"), ["--check", server.file("ball.json")], { encoding: "utf8" });
  assert.equal(checked.status, 0, checked.stderr + checked.stdout);
  assert.match(await drop("notes.txt"), /not a mesh/);
  assert.equal(await page.evaluate(() => window.incise.progress.hashAgrees), true);
  assert.deepEqual(faults, []);
});

test("pages with names of their own cut at the same time, and one name is one blade", async (t) => {
  const server = await serve(t);
  const options = { width: 1280, height: 720 };
  const { page: first, faults } = await look(t, `${server.url}#name=Dr.%20Li`, options);
  const { page: second } = await look(t, server.url, options);
  for (const page of [first, second]) await bladeIsReady(page);
  // A blade that nobody holds any more stays in the figures.
  const held = (blades) => blades.filter((blade) => blade.held);
  const names = async () => held((await server.stats()).blades).map((blade) => blade.name).sort();
  assert.deepEqual(await names(), ["Dr. Li", "mouse"]);
  // A name that is typed is kept, and its letters are no keys.
  await second.locator("#more summary").click();
  await second.locator("#blade-name").fill("Cut Two");
  await second.keyboard.press("t");
  assert.equal(await second.evaluate(() => window.incise.tool), "cut");
  await shot(second, "more_name");
  await second.keyboard.press("Enter");
  await until(second, () => localStorage.getItem("incise-name") === "Cut Twot");
  for (let tries = 0; tries < 100 && (await names()).join() !== "Cut Twot,Dr. Li"; ++tries) await second.waitForTimeout(100);
  assert.deepEqual(await names(), ["Cut Twot", "Dr. Li"]);
  await second.reload();
  await until(second, () => window.incise?.progress && document.body.dataset.blade === "open");
  assert.ok((await names()).includes("Cut Twot"));
  await drag(first, [0.3, 0.2], [0.36, 0.85]);
  await until(second, () => window.incise.live.strokes.length === 1);
  await drag(second, [0.6, 0.2], [0.66, 0.85]);
  const legend = (page, names) =>
    until(
      page,
      (names) => [...document.querySelectorAll("#blades li")].map((row) => row.textContent).join() === names,
      names,
    );
  await legend(first, "Dr. Li (you),Cut Twot");
  await legend(second, "Dr. Li,Cut Twot (you)");
  assert.match(first.url(), /name=Dr\.%20Li/);
  // The same name: somebody has it, and after a takeover both hands are in the legend.
  const { page: third } = await look(t, `${server.url}#name=Dr.%20Li`, options);
  await third.getByRole("button", { name: "Take it over" }).click();
  await bladeIsReady(third);
  await drag(third, [0.45, 0.2], [0.5, 0.85]);
  await legend(first, "Dr. Li (you),Cut Twot,Dr. Li");
  assert.deepEqual(faults, []);
});
