// What the body shows inside: a volume image with a formula, and regions, on cut faces and in the section.

import assert from "node:assert/strict";
import { copyFileSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { layerMaterials, rampAt, writeLayers, writeRamp } from "./inside_bodies.mjs";
import { atRevision, look, serve, shot } from "./page.mjs";
import { paintedCube } from "./painted.mjs";
import { until } from "./server.mjs";

function folder(t) {
  const path = mkdtempSync(join(tmpdir(), "incise_inside_"));
  t.after(() => rmSync(path, { recursive: true, force: true }));
  return path;
}

/** Cut faces (or all) that are seen, opened: where their middle is in the body at rest, its colour in the picture, normal, region. */
const facesSeen = (page, cut) =>
  page.evaluate(async (onlyCut) => {
    const { stage } = window.incise;
    const { body } = stage;
    const attribute = (name) => body.mesh.geometry.getAttribute(name)?.array;
    const rest = attribute("aRest") ?? attribute("position"),
      regions = attribute("aRegion");
    const { corners, isCut, slots } = body.shown(stage.openNow);
    stage.renderer.setPixelRatio(1);
    stage.renderer.render(stage.scene, stage.camera);
    const gl = stage.renderer.getContext();
    const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    const p = new Float64Array(9);
    const out = [];
    for (let slot = 0; slot < slots; ++slot) {
      if (!corners(slot, p) || (onlyCut && !isCut(slot))) continue;
      const mean = (a, at) => [0, 1, 2].map((i) => (a[at + i] + a[at + 3 + i] + a[at + 6 + i]) / 3);
      const v = stage.camera.position
        .clone()
        .set(...mean(p, 0))
        .project(stage.camera);
      if (Math.abs(v.x) > 1 || Math.abs(v.y) > 1) continue;
      const hit = stage.pick(v.x, v.y);
      if (hit?.slot !== slot) continue;
      const x = Math.floor(((v.x + 1) / 2) * width),
        y = Math.floor(((v.y + 1) / 2) * height);
      const at = 4 * (x + width * y);
      const side = (k) => [0, 1, 2].map((i) => p[3 * k + i] - p[i]);
      const [a, b] = [side(1), side(2)];
      const n = [0, 1, 2].map((i) => a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3]);
      out.push({
        rest: mean(rest, 9 * slot),
        colour: [...pixels.subarray(at, at + 3)],
        normal: n.map((c) => c / Math.hypot(...n)),
        region: regions?.[3 * slot],
      });
    }
    return out;
  }, cut);

/** The colour at these places of the section plane, which lies in the body's coordinates: [r, g, b] each. */
const coloursAt = (page, places) =>
  page.evaluate(async (points) => {
    const { stage } = window.incise;
    stage.renderer.setPixelRatio(1);
    stage.render();
    const gl = stage.renderer.getContext();
    return points.map((p) => {
      const v = stage.camera.position
        .clone()
        .set(...p)
        .project(stage.camera);
      const pixel = new Uint8Array(4);
      gl.readPixels(
        ((v.x + 1) / 2) * gl.drawingBufferWidth,
        ((v.y + 1) / 2) * gl.drawingBufferHeight,
        1,
        1,
        gl.RGBA,
        gl.UNSIGNED_BYTE,
        pixel,
      );
      return [...pixel.subarray(0, 3)];
    });
  }, places);

const rests = (page) => until(page, () => window.incise.stage.atRest);
const define = (page, name, value) =>
  until(page, ([n, v]) => window.incise.stage.body.mesh.material.defines[n] === v, [name, value]);

test("an oblique image in millimetres is on cut faces and in the section where its formula says", async (t) => {
  const files = folder(t);
  paintedCube(files);
  const ramp = writeRamp(files);
  const window_ = [100, 800];
  const server = await serve(t, {
    mesh: { path: join(files, "cube.obj"), target_tets: 4000, image: ramp.path, image_window: window_ },
  });
  const { page, faults } = await look(t, server.url, { width: 1000, height: 700 });
  const wanted = (p) => 255 * Math.min(1, Math.max(0, (1000 * rampAt(p) - window_[0]) / (window_[1] - window_[0])));
  server.stream([0.06], { depth_m: 0.12 });
  await until(page, () => window.incise.progress.pieces > 1 && window.incise.stage.atRest);
  await page.evaluate(() => {
    const { stage, look } = window.incise;
    look.togglePanel(true);
    stage.setOpen(1, true);
    stage.lookFrom([-0.9, -0.3, 0.35]);
  });
  await rests(page);
  const tissue = await facesSeen(page, true);
  assert.ok(tissue.length > 20 && tissue.every(({ colour: [r, g, b] }) => r > g && r > b), "tissue is red or yellow");

  await page.locator("#inside").getByText("Image").click();
  await define(page, "IMAGE", 1);
  await rests(page);
  const faces = (await facesSeen(page, true)).filter(({ normal }) => Math.abs(normal[0]) > 0.98);
  assert.ok(faces.length > 20, `${faces.length} faces are seen`);
  const within = faces.filter(({ rest }) => ramp.covers(rest) > 1 && wanted(rest) > 40);
  assert.ok(within.length > 15);
  const ratios = within.map(({ rest, colour }) => colour[0] / wanted(rest));
  for (const [i, { colour }] of within.entries()) {
    assert.ok(colour[0] === colour[1] && colour[1] === colour[2], `grey: ${colour}`);
    // Lit: the same for all of a plane, from 0.7 to 1.
    assert.ok(ratios[i] > 0.68 && ratios[i] < 1.03, `${ratios[i]}`);
    assert.ok(Math.abs(ratios[i] / ratios[0] - 1) < 0.06, `${ratios[i]} and ${ratios[0]}`);
  }
  await shot(page, "image_cut");

  // The section: exact, since it is read there. With the body closed, then with its pieces apart, of which the image goes along.
  await page.evaluate(() => {
    const { stage, look } = window.incise;
    look.showState({ inside: "image", section: { normal: [0, 0, 1], share: 0.55 } });
    stage.setOpen(0, true);
    stage.lookFrom([0.05, -0.2, 1]);
  });
  await rests(page);
  const z = await page.evaluate(() => window.incise.stage.plane[3]); // the share is of a little more than the body
  const places = [];
  for (let x = 0.005; x < 0.1; x += 0.01) for (let y = 0.005; y < 0.1; y += 0.01) places.push([x, y, z]);
  const clear = places.filter(([x]) => Math.abs(x - 0.06) > 0.006);
  let inside = 0;
  const colours = await coloursAt(page, clear);
  for (const [i, p] of clear.entries()) {
    const far = ramp.covers(p);
    if (Math.abs(far) < 1) continue; // at the image's border
    const [r, g, b] = colours[i];
    if (far > 0) {
      ++inside;
      assert.ok(Math.abs(r - wanted(p)) <= 3 && r === g && g === b, `${p}: ${colours[i]}, wanted ${wanted(p)}`);
    } else {
      assert.ok(r > 1.3 * g, `tissue outside of the image at ${p}: ${colours[i]}`);
    }
  }
  assert.ok(inside > 60, `${inside} places are in the image`);
  await page.evaluate(() => window.incise.stage.setOpen(1, true));
  await rests(page);
  const moved = await page.evaluate(() => {
    const { body } = window.incise.stage;
    const table = body.mesh.material.uniforms.uPieces.value.image.data;
    return [0, 1].map((row) => [...table.slice(4 * row, 4 * row + 3)]);
  });
  assert.ok(Math.abs(moved[0][0] - moved[1][0]) > 0.02, "the pieces are apart");
  // Which of the two pieces is on the left: the plane moves with neither.
  const left = moved[0][0] < moved[1][0] ? moved[0] : moved[1],
    right = left === moved[0] ? moved[1] : moved[0];
  const sample = clear.filter(([x, y]) => ramp.covers([x, y, z]) > 2 && y > 0.02 && y < 0.08 && x > 0.02 && x < 0.09);
  const where = sample.map((p) => {
    const by = p[0] < 0.06 ? left : right;
    return [p[0] + by[0], p[1] + by[1], z];
  });
  const after = await coloursAt(page, where);
  for (const [i, p] of sample.entries()) {
    const by = p[0] < 0.06 ? left : right;
    const value = wanted([p[0], p[1], z - by[2]]);
    assert.ok(Math.abs(after[i][0] - value) <= 4, `${p}: ${after[i]}, wanted ${value}`);
  }
  await shot(page, "image_section");
  // The key takes it away again, the address keeps it.
  await page.keyboard.press("v");
  await define(page, "IMAGE", 0);
  await until(page, () => location.hash.includes("section=") && !location.hash.includes("inside=image"));
  await page.keyboard.press("v");
  await until(page, () => location.hash.includes("inside=image"));
  const again = await look(t, page.url());
  await define(again.page, "IMAGE", 1);
  assert.deepEqual([...faults, ...again.faults], []);
});

test("cut faces and the section change colour where a region ends, also after another stroke and a reset", async (t) => {
  const files = folder(t);
  // Skin that the configuration paints green inside, and an image for the fat.
  const server = await serve(t, {
    mesh: { path: writeLayers(files, 12) },
    materials: [
      { region: 1, tissue: "skin", inside: { colour: [0.1, 0.8, 0.1], roughness: 0.9 } },
      ...layerMaterials.slice(1),
    ],
  });
  const { page, faults } = await look(t, server.url, { width: 1000, height: 700 });
  await define(page, "REGIONS", 1);
  const check = async () => {
    await page.evaluate(() => {
      const { stage } = window.incise;
      stage.setOpen(1, true);
      stage.lookFrom([-0.9, -0.3, 0.35]);
    });
    await rests(page);
    const faces = (await facesSeen(page, true)).filter(({ normal }) => Math.abs(normal[0]) > 0.9);
    const by = (region) => faces.filter((f) => f.region === region - 1).map((f) => f.colour);
    const count = [1, 2, 3].map((region) => by(region).length);
    assert.ok(Math.min(...count) > 3, `${count}`);
    // Green, yellow, red: of each face, and right beside the boundary too.
    for (const [r, g, b] of by(1)) assert.ok(g > 1.4 * r && g > 1.4 * b, `skin ${[r, g, b]}`);
    const share = (colours, test_) => colours.filter(test_).length / colours.length;
    assert.ok(share(by(2), ([r, g, b]) => g > 0.6 * r && b < 0.9 * g) > 0.85, `fat ${by(2).join(" ")}`);
    assert.ok(share(by(3), ([r, g]) => g < 0.6 * r) > 0.85, `muscle ${by(3).join(" ")}`);
  };
  server.stream([0.01], { depth_m: 0.09 });
  await until(page, () => window.incise.progress.pieces > 1);
  await check();
  await shot(page, "layers");
  server.stream([-0.03], { depth_m: 0.09 });
  await until(page, () => window.incise.progress.pieces > 2);
  await check();
  // The section knows the regions inside, which the skin behind it does not show.
  await page.evaluate(() => {
    const { stage, look } = window.incise;
    look.showState({ section: { normal: [0, -1, 0], share: 0.5 } });
    stage.setOpen(0, true);
    stage.lookFrom([0, -1, 0.2]);
  });
  await rests(page);
  const height = 0.08 / 8;
  const column = (z) => [-0.05, -0.045, 0.04, 0.045, 0.05].map((x) => [x, 0, z]);
  for (const [z, is] of [
    [0.08 - 0.3 * height, ([r, g]) => g > 1.3 * r],
    [0.08 - 1.4 * height, ([r, g, b]) => g > 0.6 * r && b < 0.9 * g],
    [0.08 - 3.6 * height, ([r, g, b]) => g > 0.6 * r && b < 0.9 * g],
    [0.08 - 4.5 * height, ([r, g]) => g < 0.65 * r],
    [0.01, ([r, g]) => g < 0.65 * r],
  ]) {
    const seen = await coloursAt(page, column(z));
    assert.ok(seen.filter(is).length >= 4, `at ${z}: ${seen.join(" ")}`);
  }
  await shot(page, "layers_section");
  assert.equal(await page.evaluate(() => document.getElementById("inside-row").hidden), true);
  await page.evaluate(() => window.incise.send({ kind: "reset" }));
  await atRevision(page, 0);
  await page.evaluate(() => window.incise.look.showState({}));
  server.stream([0.02], { depth_m: 0.09 });
  await until(page, () => window.incise.progress.pieces > 1);
  await check();
  assert.deepEqual(faults, []);
});

test("regions that the configuration does not name differ, and a texture of one is on its faces alone", async (t) => {
  const files = folder(t);
  paintedCube(files); // for its image: blue above, green below
  const path = writeLayers(files, 10);
  const bare = await serve(t, { mesh: { path } });
  const opened = await look(t, bare.url);
  await define(opened.page, "REGIONS", 1);
  const json = await (await fetch(`${bare.url}look.json`)).json();
  assert.equal(new Set(json.regions.map((r) => r.inside.colour.join())).size, 4);

  const server = await serve(t, {
    mesh: { path },
    materials: [
      {
        region: 3,
        tissue: "muscle",
        inside: { texture: join(files, "paint.png") },
        surface: { texture: join(files, "paint.png") },
      },
    ],
  });
  const { page, faults } = await look(t, server.url);
  await define(page, "REGION_TEXTURES", 1);
  server.stream([0.01], { depth_m: 0.09 });
  await until(page, () => window.incise.progress.pieces > 1);
  await page.evaluate(() => {
    window.incise.stage.setOpen(1, true);
    window.incise.stage.lookFrom([-0.9, -0.3, 0.35]);
  });
  await rests(page);
  const faces = await facesSeen(page, true);
  const painted = ([r, g, b]) => Math.max(g, b) > 1.25 * r;
  const share = (list) => list.filter((f) => painted(f.colour)).length / list.length;
  assert.ok(share(faces.filter((f) => f.region === 2)) > 0.7);
  assert.ok(share(faces.filter((f) => f.region === 1)) < 0.2);
  await shot(page, "region_texture");
  assert.deepEqual([...faults, ...opened.faults], []);
});

test("a texture that cannot be decoded costs itself alone, and a notice names it", async (t) => {
  const files = folder(t);
  paintedCube(files);
  copyFileSync(join(files, "paint.png"), join(files, "other.png"));
  const layers = writeLayers(files, 10);
  const damage = (page, path) =>
    page.route(`**${path}`, async (route) => {
      const answer = await route.fetch();
      await route.fulfill({ response: answer, body: (await answer.body()).subarray(0, 60) });
    });
  const named = (page, path) =>
    until(
      page,
      (path) => [...document.querySelectorAll(".notice p")].some((p) => p.textContent.includes(`${path} is no image`)),
      path,
    );
  const image = writeRamp(files).path;
  const side = (name) => ({ texture: join(files, name) });
  const server = await serve(t, {
    mesh: { path: layers, image },
    materials: [
      { region: 2, tissue: "fat", inside: side("other.png"), surface: side("other.png") },
      { region: 3, tissue: "muscle", inside: side("paint.png"), surface: side("paint.png") },
    ],
  });
  const { page, faults } = await look(t, server.url);
  await define(page, "REGION_TEXTURES", 1);
  const { regions } = await (await fetch(`${server.url}look.json`)).json();
  const of = (region) => regions.find((r) => r.region === region).inside.texture;
  assert.notEqual(of(2), of(3));
  await damage(page, of(2));
  await page.reload();
  await named(page, of(2));
  await define(page, "REGION_TEXTURES", 1);
  const rows = await page.evaluate(() => [...window.incise.stage.body.look.uniforms.uLooks.value.image.data]);
  const layerOf = (region) => rows[16 * regions.findIndex((r) => r.region === region) + 7];
  assert.deepEqual([layerOf(2), layerOf(3)], [-1, 0]);
  assert.equal(await page.locator("#inside-row").evaluate((row) => row.hidden), false);
  // All of them: the looks and the image are still there.
  await damage(page, of(3));
  await page.reload();
  await until(page, () => window.incise?.stage.body.mesh.material.defines.REGIONS === 1);
  await define(page, "REGION_TEXTURES", 0);
  assert.equal(await page.locator("#inside-row").evaluate((row) => row.hidden), false);

  // The texture of the surface that a body was filled from: the other materials keep their colours.
  const cube = await serve(t, { mesh: { path: join(files, "cube.obj"), target_tets: 4000 } });
  const painted = await look(t, cube.url);
  await define(painted.page, "TEXTURE", 1);
  const surface = "/surface/0.png";
  await damage(painted.page, surface);
  await painted.page.reload();
  await named(painted.page, surface);
  await until(painted.page, () => window.incise?.stage.body.mesh.material.defines.TEXTURE === 1);
  assert.deepEqual([...faults, ...painted.faults], []);
});

test("an image that cannot be used gets one line, and no server starts", async (t) => {
  const files = folder(t);
  writeFileSync(join(files, "bad.nrrd"), "NRRD0004\ntype: block\n\n");
  await assert.rejects(
    serve(t, { mesh: { phantom: "slab", target_tets: 2000, image: join(files, "bad.nrrd") } }),
    /ended before it listened/,
  );
});
