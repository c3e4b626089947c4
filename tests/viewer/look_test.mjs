// How the page looks and is reached, in a real browser against a real server.

import assert from "node:assert/strict";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { atRevision, bladeIsReady, look, serve, shot } from "./page.mjs";
import { paintedCube } from "./painted.mjs";
import { launch, until } from "./server.mjs";

test("a picture at rest is not drawn again, a moving one is", async (t) => {
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

/** The smallest dihedral angle of the tetrahedron behind each boundary face of TetGen files, degrees; sorted. */
function boundaryAngles(base) {
  const rows = (ending) =>
    readFileSync(base + ending, "utf8")
      .split("\n")
      .filter((line) => line && line[0] !== "#")
      .slice(1)
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
        const [u, v] = [0, 1, 2, 3]
          .filter((k) => k !== i && k !== j)
          .map((k) => {
            const arm = minus(p[k], p[i]);
            return unit(arm.map((x, n) => x - axis[n] * dot(arm, axis)));
          });
        least = Math.min(least, (Math.acos(Math.min(1, Math.max(-1, dot(u, v)))) * 180) / Math.PI);
      }
    }
    for (let k = 0; k < 4; ++k) {
      const face = corners
        .slice(0, 4)
        .filter((_, i) => i !== k)
        .sort((a, b) => a - b)
        .join();
      faces.set(face, [...(faces.get(face) ?? []), t]);
    }
    return least;
  });
  return [...faces.values()]
    .filter((tets) => tets.length === 1)
    .map(([t]) => angles[t])
    .sort((a, b) => a - b);
}

test("the colours of quality are the smallest dihedral angles of the tetrahedra", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 1280, height: 800 });
  await page.getByText("Quality").click();
  server.stream([0.03]);
  const { revision } = await server.stats();
  const angles = () =>
    page.evaluate(() => {
      const { body } = window.incise.stage;
      const facts = body.mesh.geometry.getAttribute("aFacts").array;
      const positions = body.mesh.geometry.getAttribute("position").array;
      const shown = [];
      for (let slot = 0; slot < body.slots; ++slot) {
        if (positions.subarray(9 * slot, 9 * slot + 9).some((x) => x !== 0))
          shown.push((facts[12 * slot + 1] * 45) / 255);
      }
      return shown.sort((a, b) => a - b);
    });
  await until(page, (r) => window.incise.progress.revision === r, revision);
  await server.stop(); // its capture is whole then; the page keeps what it holds
  const base = server.file("state");
  server.incise("export", server.file("session.capture"), "--out", `${base}.node`);
  const wanted = boundaryAngles(base).map((angle) => Math.min(angle, 45));
  let shown = [];
  for (let tries = 0; tries < 300; ++tries) {
    // the tetrahedra come on a connection of their own, at most 20 times a second
    shown = await angles();
    if (shown.length === wanted.length && shown.every((angle, i) => Math.abs(angle - wanted[i]) < 0.2)) break;
    await page.waitForTimeout(100);
  }
  assert.equal(shown.length, wanted.length);
  for (const [i, angle] of shown.entries()) {
    assert.ok(Math.abs(angle - wanted[i]) < 0.2, `face ${i}: ${angle}, wanted ${wanted[i]}`);
  }
  assert.ok(shown[0] < 30 && shown.at(-1) > 40);
  await shot(page, "quality");
  assert.deepEqual(faults, []);
});

test("everything is reached by keyboard and has a name", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { colorScheme: "light", width: 1280, height: 800 });
  await until(page, () => window.incise.stage.framesDrawn > 0);
  await shot(page, "loaded_light");
  const nameless = await page.evaluate(() =>
    [...document.querySelectorAll("button, input, select, a, [role=img]")]
      .filter((e) => !(e.getAttribute("aria-label") || e.labels?.[0]?.textContent.trim() || e.textContent.trim()))
      .map((e) => e.outerHTML),
  );
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
  for (const id of ["theme", "panel-toggle", "wire", "depth", "length", "tilt", "open", "fit", "reset"])
    assert.ok(seen.has(id), id);
  assert.deepEqual(faults, []);
});

test("keys work in capitals and without focus, and a question mark lists them", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 1280, height: 800 });
  await until(page, () => window.incise.stage.framesDrawn > 0);
  // The controls set the position again with every frame, and the last bits differ.
  const camera = () => page.evaluate(() => window.incise.stage.camera.position.toArray().map((x) => x.toFixed(9)));
  const before = await camera();
  await page.keyboard.press("ArrowRight");
  assert.notDeepEqual(await camera(), before);
  const turned = await camera();
  await page.keyboard.press("+");
  assert.notDeepEqual(await camera(), turned);
  await page.keyboard.press("T");
  assert.equal(await page.evaluate(() => window.incise.tool), "turn");
  await page.keyboard.press("W");
  assert.equal(await page.isChecked("#wire"), true);
  // A slider that has the focus keeps its arrows.
  await page.locator("#depth").focus();
  const still = await camera();
  await page.keyboard.press("ArrowLeft");
  assert.deepEqual(await camera(), still);
  assert.notEqual(await page.textContent("#depth-text"), "through");
  await page.keyboard.press("?");
  await page.locator("#help-dialog[open]").waitFor();
  await shot(page, "help");
  assert.ok(await page.evaluate(() => keys.scrollHeight <= keys.clientHeight), "all keys are seen at a height of 800");
  // In a low window the keys are rolled, and the button is always there.
  await page.setViewportSize({ width: 1280, height: 500 });
  const [dialog, close] = await Promise.all(
    ["#help-dialog", "#help-dialog button"].map((part) => page.locator(part).boundingBox()),
  );
  assert.ok(dialog.y >= 0 && dialog.y + dialog.height <= 500, JSON.stringify(dialog));
  assert.ok(close.y + close.height < dialog.y + dialog.height, JSON.stringify([dialog, close]));
  await page.locator("#keys div").last().scrollIntoViewIfNeeded();
  const last = await page.locator("#keys div").last().boundingBox();
  assert.ok(last.y + last.height <= close.y, JSON.stringify([last, close]));
  await page.setViewportSize({ width: 1280, height: 800 });
  // Every key that a tooltip names is listed, and each is there once.
  const listed = await page.locator("#keys kbd").allTextContents();
  const named = await page.evaluate(() =>
    [...document.querySelectorAll("[title]")].flatMap(
      (e) => /\(([^)]{1,7})\)$/.exec(e.title)?.[1].split(" and ") ?? [],
    ),
  );
  assert.ok(named.length > 10);
  for (const key of named) assert.ok(listed.includes(key), key);
  assert.equal(new Set(listed).size, listed.length);
  await page.keyboard.press("Escape");
  await page.locator("#help-dialog").waitFor({ state: "hidden" });
  assert.deepEqual(faults, []);
});

test("without WebGL the page says what is missing", async (t) => {
  const server = await serve(t);
  const plain = await launch("--disable-gpu", "--disable-3d-apis");
  t.after(() => plain.close());
  const page = await plain.newPage({ viewport: { width: 1280, height: 760 } });
  await page.goto(server.url);
  await page.getByText("offers no WebGL 2").waitFor();
  assert.equal(await page.textContent("#connection-text"), "No picture");
  await shot(page, "no_webgl");
});

test("a section faces who looks, goes along any axis and draws where it meets skin and cuts", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 1280, height: 800 });
  await until(page, () => window.incise.stage.framesDrawn > 0);
  server.stream([0.03]);
  await atRevision(page, (await server.stats()).revision);
  await page.locator("#open").fill("0");
  await page.keyboard.press("s");
  const section = () =>
    page.evaluate(() => {
      const { stage } = window.incise;
      const [x, y, z, offset] = stage.body.uniforms.uSection.value.toArray();
      const size = (mesh) => mesh.geometry.getAttribute("position")?.count ?? 0;
      stage.colourAt(0.5, 0.5); // draws
      const { skin, cuts } = stage.sectionLines;
      return {
        normal: [x, y, z],
        offset,
        towardsEye: [x, y, z].reduce((sum, n, i) => sum + n * stage.toEye[i], 0),
        skin: size(skin),
        cuts: size(cuts),
      };
    });
  await until(page, () => window.incise.stage.atRest);
  const first = await section();
  assert.deepEqual(first.normal.map(Math.abs), [0, 0, 1]); // along which one looks most at the start
  assert.ok(first.towardsEye > 0);
  assert.ok(first.skin > 0 && first.cuts > 0);
  await shot(page, "section_z");
  for (const [axis, name] of ["X", "Y", "Z"].entries()) {
    await page.locator("#section-axis").getByText(name).click();
    await until(page, () => window.incise.stage.atRest);
    const shown = await section();
    assert.deepEqual(
      shown.normal.map(Math.abs),
      [0, 1, 2].map((k) => Number(k === axis)),
    );
    assert.ok(shown.towardsEye > 0, name);
    assert.ok(shown.skin > 0, name);
  }
  const { normal, offset } = await section();
  await page.locator("#section-at").fill("0.6");
  assert.notEqual((await section()).offset, offset);
  await page.locator("#section-flip").click();
  await until(page, () => window.incise.stage.atRest);
  const other = await section();
  assert.deepEqual(
    other.normal,
    normal.map((n) => -n || 0),
  );
  assert.ok(other.towardsEye > 0); // seen from the other side, where its skin does not hide it
  await page.keyboard.press("s");
  assert.deepEqual((await section()).normal, [0, 0, 0]);
  assert.deepEqual(faults, []);
});

test("handles and keys move and turn a section, which neither cuts nor turns the body", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 1280, height: 800 });
  await bladeIsReady(page);
  await page.keyboard.press("s");
  await page.keyboard.press("7");
  await until(page, () => window.incise.stage.atRest);
  const state = () =>
    page.evaluate(() => {
      const { stage, look } = window.incise;
      const { foot, knob } = look.handle.frame();
      const at = (place) => stage.marks.onScreen(place);
      return {
        plane: stage.body.uniforms.uSection.value.toArray(),
        middle: at(foot),
        knob: at(foot.clone().addScaledVector(knob, 0.3 * stage.bodySize_m)),
        camera: stage.cameraPlace.position,
        axis: document.querySelector("#section-axis :checked")?.value ?? "",
        bright: stage.sectionLines.skin.material.color.r,
        revision: window.incise.progress.revision,
      };
    });
  const angle = (a, b) => (180 / Math.PI) * Math.acos(Math.min(1, a[0] * b[0] + a[1] * b[1] + a[2] * b[2]));
  const dragBy = async ([x, y], dx, dy) => {
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.mouse.move(x + dx, y + dy, { steps: 6 });
    await page.mouse.up();
  };
  const first = await state();
  assert.equal(first.axis, "z");
  await dragBy(first.middle, 0, -60); // z is up
  const moved = await state();
  assert.deepEqual(moved.plane.slice(0, 3), first.plane.slice(0, 3));
  assert.ok(moved.plane[3] > first.plane[3] + 0.005, JSON.stringify(moved.plane));
  assert.ok(
    Math.hypot(moved.middle[0] - first.middle[0], moved.middle[1] - first.middle[1] + 60) < 2,
    "under the hand",
  );
  await until(page, () => window.incise.stage.atRest);
  await shot(page, "section_moved");
  await dragBy(moved.knob, -90, 50);
  const turned = await state();
  assert.ok(angle(turned.plane, moved.plane) > 15, JSON.stringify(turned.plane));
  assert.ok(Math.hypot(turned.middle[0] - moved.middle[0], turned.middle[1] - moved.middle[1]) < 2, "about its middle");
  assert.equal(turned.axis, "");
  assert.notEqual(turned.bright, moved.bright);
  await until(page, () => window.incise.stage.atRest);
  await shot(page, "section_turned");
  // Escape puts it back while it is dragged.
  await page.mouse.move(...turned.middle);
  await page.mouse.down();
  await page.mouse.move(turned.middle[0] + 20, turned.middle[1] - 80, { steps: 3 });
  assert.ok(Math.abs((await state()).plane[3] - turned.plane[3]) > 0.003);
  await page.keyboard.press("Escape");
  await page.mouse.up();
  for (const [k, x] of (await state()).plane.entries()) assert.ok(Math.abs(x - turned.plane[k]) < 1e-6);
  // Keys do the same in steps.
  await page.keyboard.press("Shift+ArrowRight");
  const stepped = await state();
  assert.ok(Math.abs(angle(stepped.plane, turned.plane) - 5) < 3);
  await page.keyboard.press("PageUp");
  assert.ok((await state()).plane[3] > stepped.plane[3]);
  await page.locator("#section-view").click();
  const facing = await state();
  const eye = await page.evaluate(() => window.incise.stage.toEye.map((x, _, v) => x / Math.hypot(...v)));
  assert.ok(angle(facing.plane, eye) < 0.1);
  await dragBy(facing.middle, 0, 60); // nearer, though its normal is seen end on
  assert.ok((await state()).plane[3] > facing.plane[3] + 0.003);
  const last = await state();
  assert.deepEqual(last.camera, first.camera);
  assert.equal(last.revision, 0);
  await page.locator("#section-axis").getByText("X").click();
  assert.deepEqual((await state()).plane.slice(0, 3), [1, 0, 0]);
  // Off while it is dragged, it stays off.
  await page.mouse.move(...(await state()).middle);
  assert.equal(await page.evaluate(() => document.body.dataset.handle), "move");
  await page.mouse.down();
  await page.keyboard.press("s");
  await page.mouse.move(400, 300, { steps: 3 });
  await page.mouse.up();
  assert.equal(await page.evaluate(() => document.body.dataset.handle), undefined);
  assert.equal(await page.evaluate(() => window.incise.stage.plane), null);
  await dragBy(last.middle, 80, 0); // the handle is gone: this is a stroke
  await until(page, () => window.incise.progress.revision > 0);
  assert.deepEqual(faults, []);
});

test("open lifts the lips of a cut that stops inside, and leaves faces that were parted as they are", async (t) => {
  const server = await serve(t, { mesh: { phantom: "liver", target_tets: 20000 } });
  const { page, faults } = await look(t, server.url);
  // Along x, with the tip in the middle of the body; then right through, across it.
  const middle = await page.evaluate(() => window.incise.stage.centre.toArray());
  const [x, y, z] = middle;
  server.streamPasses([
    [
      [x - 0.15, y, z + 0.12],
      [x + 0.15, y, z + 0.12],
    ],
    [
      [x + 0.013, -0.15, 0.07],
      [x + 0.013, 0.15, 0.07],
    ],
  ]);
  await atRevision(page, (await server.stats()).revision);
  await until(page, () => window.incise.progress.pieces >= 2);
  await page.locator("#open").fill("1");
  /** How far the faces that the second pass parted are moved, in the plane of that pass and out of it. */
  const measure = (at) =>
    page.evaluate((at) => {
      const attribute = (name) => window.incise.stage.body.mesh.geometry.getAttribute(name).array;
      const positions = attribute("position"),
        facts = attribute("aFacts"),
        lips = attribute("aLips");
      const found = { parted: 0, off: 0, along: 0, most: 0 };
      for (let slot = 0; slot < window.incise.stage.body.slots; ++slot) {
        const own = lips.subarray(9 * slot, 9 * slot + 9);
        for (const d of own) found.most = Math.max(found.most, Math.abs(d));
        if (!facts[12 * slot] || ![0, 3, 6].every((k) => Math.abs(positions[9 * slot + k] - at) < 1e-5)) continue;
        ++found.parted;
        for (const [i, d] of own.entries()) {
          const way = i % 3 === 0 ? "off" : "along";
          found[way] = Math.max(found[way], Math.abs(d));
        }
      }
      return found;
    }, at);
  let moved = await measure(Math.fround(x + 0.013));
  for (let tries = 0; tries < 300 && !(moved.along > 0.5 * moved.most && moved.off < 0.1 * moved.most); ++tries) {
    // until the last state's opening is there
    await page.waitForTimeout(100);
    moved = await measure(Math.fround(x + 0.013));
  }
  await shot(page, "open_crossing");
  assert.ok(moved.parted > 100, `${moved.parted} faces in the plane`);
  assert.ok(moved.along > 0.5 * moved.most, "the slit's ends in them gape");
  assert.ok(moved.most > 0.01, `lips are lifted by ${moved.most} m`);
  assert.ok(moved.off < 0.1 * moved.most, `${moved.off} m out of their plane, lips ${moved.most}`);
  assert.deepEqual(faults, []);
});

test("a phone shows it all, and a finger cuts", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 390, height: 780, hasTouch: true, isMobile: true });
  await bladeIsReady(page);
  const wide = await page.evaluate(() => document.documentElement.scrollWidth);
  assert.ok(wide <= 390, `${wide} px wide`);
  const cdp = await page.context().newCDPSession(page);
  const finger = (type, y) =>
    cdp.send("Input.dispatchTouchEvent", { type, touchPoints: type === "touchEnd" ? [] : [{ x: 180 + y / 40, y }] });
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

test("a window that becomes narrow is as one that was opened narrow, and back", async (t) => {
  const server = await serve(t);
  const { page, faults } = await look(t, server.url, { width: 1200, height: 800 });
  await bladeIsReady(page);
  const panel = () => page.evaluate(() => document.body.dataset.panel);
  assert.equal(await panel(), "open");
  await page.setViewportSize({ width: 400, height: 800 });
  await until(page, () => document.body.dataset.panel === "closed");
  assert.ok(await page.locator("#tools").isVisible());
  const whole = () =>
    page.evaluate(() => {
      const { stage } = window.incise;
      stage.camera.updateMatrixWorld();
      return [0, 1, 2, 3, 4, 5, 6, 7].every((k) => {
        const corner = stage.camera.position.clone();
        corner
          .fromArray([0, 1, 2].map((axis) => ((k >> axis) & 1 ? stage.max : stage.min)[axis]))
          .project(stage.camera);
        return Math.abs(corner.x) <= 1.05 && Math.abs(corner.y) <= 1.05;
      });
    });
  await until(page, () => window.incise.stage.atRest);
  assert.ok(await whole(), "the body stays in view");
  await page.locator("#panel-toggle").click();
  assert.equal(await panel(), "open");
  await page.setViewportSize({ width: 400, height: 700 }); // as by a keyboard on the screen
  assert.equal(await panel(), "open");
  await page.locator("#panel-toggle").click();
  await page.setViewportSize({ width: 1200, height: 800 });
  await until(page, () => document.body.dataset.panel === "open");
  await page.locator("#panel-toggle").click();
  await page.setViewportSize({ width: 400, height: 800 });
  await page.setViewportSize({ width: 1200, height: 800 });
  await page.waitForTimeout(200);
  assert.equal(await panel(), "closed", "what the user has closed stays closed");
  assert.deepEqual(faults, []);
});

test("a body that was filled from a surface shows that surface's texture, cut or not", async (t) => {
  const files = mkdtempSync(join(tmpdir(), "incise_painted_"));
  t.after(() => rmSync(files, { recursive: true }));
  paintedCube(files);
  const server = await serve(t, { mesh: { path: join(files, "cube.obj"), target_tets: 4000 } });
  const { page, faults } = await look(t, server.url);
  await until(page, () => window.incise.stage.body.mesh.material.defines.TEXTURE === 1 && window.incise.stage.atRest);
  /** The picture's colour where this point of the body is seen. */
  const colourAt = (point) =>
    page.evaluate(async (p) => {
      const { stage } = window.incise;
      stage.lookFrom([0, -1, 0.2]);
      await new Promise((done) => setTimeout(done, 600));
      const v = stage.camera.position
        .clone()
        .set(...p)
        .project(stage.camera);
      const gl = stage.renderer.getContext();
      stage.renderer.render(stage.scene, stage.camera);
      const pixel = new Uint8Array(4);
      const x = ((v.x + 1) / 2) * gl.drawingBufferWidth,
        y = ((v.y + 1) / 2) * gl.drawingBufferHeight;
      gl.readPixels(x, y, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
      return [...pixel];
    }, point);
  const isPainted = async () => {
    const [low, high] = [await colourAt([0.03, 0, 0.025]), await colourAt([0.03, 0, 0.075])];
    assert.ok(low[1] > 1.5 * low[0] && low[1] > 1.5 * low[2], `green: ${low}`);
    assert.ok(high[2] > 1.5 * high[0] && high[2] > 1.5 * high[1], `blue: ${high}`);
  };
  await isPainted();
  server.stream([0.06], { depth_m: 0.12 });
  await until(page, () => window.incise.progress.pieces > 1 && window.incise.stage.atRest);
  await isPainted();
  await shot(page, "painted");
  // So does the file that is saved: with the image, upright, and its coordinates.
  const download = page.waitForEvent("download");
  await page.keyboard.press("g");
  const glb = readFileSync(await (await download).path());
  const json = JSON.parse(glb.subarray(20, 20 + glb.readUInt32LE(12)).toString());
  const bin = glb.subarray(28 + glb.readUInt32LE(12));
  const array = (index) => {
    const { bufferView, byteOffset = 0, count, type, componentType } = json.accessors[index];
    const from = (json.bufferViews[bufferView].byteOffset ?? 0) + byteOffset;
    const size = { SCALAR: 1, VEC2: 2, VEC3: 3 }[type];
    const read = {
      5126: (at) => bin.readFloatLE(from + 4 * at),
      5123: (at) => bin.readUInt16LE(from + 2 * at),
      5125: (at) => bin.readUInt32LE(from + 4 * at),
    };
    return Array.from({ length: count * size }, (_, at) => read[componentType](at));
  };
  const seen = new Map();
  for (const { primitives } of json.meshes) {
    for (const { attributes, indices, material } of primitives) {
      const { name, pbrMetallicRoughness } = json.materials[material];
      const count = (seen.get(name) ?? 0) + array(indices).length / 3;
      seen.set(name, count);
      if (name !== "texture_1") continue;
      const image = json.images[json.textures[pbrMetallicRoughness.baseColorTexture.index].source];
      const { byteOffset, byteLength } = json.bufferViews[image.bufferView];
      const [top, bottom] = await page.evaluate(
        async ([bytes, type]) => {
          const picture = await createImageBitmap(new Blob([Uint8Array.from(bytes)], { type }));
          const pen = new OffscreenCanvas(picture.width, picture.height).getContext("2d", { willReadFrequently: true });
          pen.drawImage(picture, 0, 0);
          return [0, picture.height - 1].map((y) => [...pen.getImageData(0, y, 1, 1).data]);
        },
        [[...bin.subarray(byteOffset, byteOffset + byteLength)], image.mimeType],
      );
      assert.ok(top[2] > 200 && bottom[1] > 180, `blue above ${top}, green below ${bottom}`);
      const position = array(attributes.POSITION),
        uv = array(attributes.TEXCOORD_0);
      for (const v of array(indices))
        assert.ok(Math.abs(1 - uv[2 * v + 1] - position[3 * v + 2] / 0.1) < 1e-4, "v is the height");
    }
  }
  const triangles = (await page.evaluate(() => window.incise.progress)).triangles;
  assert.equal(
    [...seen.values()].reduce((sum, n) => sum + n, 0),
    triangles,
  );
  assert.deepEqual([...seen.keys()].sort(), ["cut", "texture_1", "texture_2"]);
  assert.deepEqual(faults, []);
});
