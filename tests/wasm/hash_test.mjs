// The same bits as native: every state that the module reaches has the hash that the native programs recorded.

import assert from "node:assert/strict";
import { readdirSync, readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { directory, emptySession, incise, root, sessionFiles, sessionOf } from "./session.mjs";

function assertSameHashes(report, name) {
  assert.ok(report.marks > 1, `${name}: the capture has hashes`);
  assert.deepEqual([report.compared, report.differs], [report.marks, 0], `${name}: compared, first that differs`);
}

test("the test captures, both policies", () => {
  const replays = join(root, "tests/replay");
  const captures = readdirSync(replays).filter((name) => name.endsWith(".capture"));
  const session = sessionOf(join(replays, captures[0]));
  assert.ok(captures.length >= 12);
  for (const name of captures) assertSameHashes(session.replay(readFileSync(join(replays, name))), name);
});

for (const phantom of ["liver", "cylinder", "slab"]) {
  test(`the demo's motion in the ${phantom}, as incise cut reports it`, () => {
    for (const prefer of ["balanced", "exact", "no-growth"]) {
      const config = join(directory, `${phantom}.json`);
      const capture = join(directory, `${phantom}.capture`);
      writeFileSync(
        config,
        JSON.stringify({
          mesh: { phantom, target_tets: 6000 },
          blade: { heel: [0, 0, 0], tip: [0, 0, -0.12] },
          cut: { prefer },
        }),
      );
      const native = JSON.parse(
        incise("convert", join(root, "config/demo_motion.csv"), "--config", config, "--out", capture, "--json"),
      );
      const report = sessionOf(capture).replay(readFileSync(capture));
      assertSameHashes(report, `${phantom}, ${prefer}`);
      assert.deepEqual([report.revision, report.state_hash], [native.batches, native.state_hash]);
    }
  });
}

test("a motion in a body that was cut and saved before", () => {
  const motion = join(root, "config/demo_motion.csv");
  const file = (name) => join(directory, name);
  const blade = { heel: [0, 0, 0], tip: [0, 0, -0.12] };
  writeFileSync(file("whole.json"), JSON.stringify({ mesh: { phantom: "liver", target_tets: 6000 }, blade }));
  incise("convert", motion, "--config", file("whole.json"), "--out", file("whole.capture"), "--json");
  incise("export", file("whole.capture"), "--out", file("saved.vtu"));
  writeFileSync(file("saved.json"), JSON.stringify({ mesh: { path: "saved.vtu" }, blade }));
  incise("convert", motion, "--config", file("saved.json"), "--out", file("saved.capture"), "--json");
  const bytes = readFileSync(file("saved.capture"));
  assertSameHashes(sessionOf(file("saved.capture")).replay(bytes), "in the saved body");
  // What blades have left in it counts.
  const { header, body } = sessionFiles(file("saved.capture"));
  const size = Number(new DataView(body.buffer, body.byteOffset).getBigUint64(0, true));
  assert.ok(size > 1000);
  const forgetful = emptySession();
  forgetful.begin(header, Buffer.concat([Buffer.alloc(8), body.subarray(8 + size)]));
  assert.ok(forgetful.replay(bytes).differs > 0);
});

test("bad input is an error with a text, and the session goes on", () => {
  const capture = join(root, "tests/replay/planar_conforming.capture");
  const { header, body } = sessionFiles(capture);
  assert.throws(() => emptySession().begin(header.subarray(0, 50), body), { message: /header/, aborted: false });
  assert.throws(() => emptySession().begin(header, body.subarray(0, -4)), { message: /cut off/, aborted: false });
  const damaged = Uint8Array.from(body);
  damaged[damaged.length - 8000] ^= 0x10;
  assert.throws(() => emptySession().begin(header, damaged), { aborted: false });

  const session = sessionOf(capture);
  const bytes = readFileSync(capture);
  const torn = Uint8Array.from(bytes);
  torn[2000] ^= 1;
  assert.throws(() => session.replay(torn), { message: /capture/, aborted: false });
  assert.throws(() => session.replay(new Uint8Array(0)), { aborted: false });
  assertSameHashes(session.replay(bytes), "afterwards");
});

const data = process.env.INCISE_DATA;

/** The first lines of a recorded motion, moved and scaled so that they fill a body's box. */
function fitted(motion, box, lines) {
  const [header, ...rows] = readFileSync(motion, "utf8").trim().split("\n");
  const names = header.split(",");
  const columns = ["x_m", "y_m", "z_m"].map((name) => names.indexOf(name));
  const table = rows.slice(0, lines).map((row) => row.split(",").map(Number));
  columns.forEach((column, k) => {
    const values = table.map((row) => row[column]);
    const [low, high] = [Math.min(...values), Math.max(...values)];
    for (const row of table) row[column] = box.min[k] + ((row[column] - low) / (high - low)) * (box.max[k] - box.min[k]);
  });
  const file = join(directory, "fitted.csv");
  writeFileSync(file, [header, ...table.map((row) => row.join())].join("\n"));
  return file;
}

test("recorded hands in real bodies", { skip: data ? false : "INCISE_DATA names no folder" }, () => {
  for (const body of ["liver_6564", "armadillo_3717", "seed_1720", "bullet_ditto.vtk", "sofa_volumetricTongue.vtu"]) {
    const mesh = join(data, "meshes", body);
    const { box_m } = JSON.parse(incise("info", mesh, "--json"));
    // Some are in millimetres, and a hand is as fast as a hand: all get the size of an organ.
    const scale = 0.25 / Math.hypot(...box_m.max.map((m, k) => m - box_m.min[k]));
    const box = { min: box_m.min.map((c) => scale * c), max: box_m.max.map((c) => scale * c) };
    for (const hand of ["geomagic_liver", "dvrk_psm2"]) {
      const config = join(directory, "real.json");
      const capture = join(directory, "real.capture");
      const blade = { heel: [0, 0, 0], tip: [0, 0, -0.08] };
      writeFileSync(config, JSON.stringify({ mesh: { path: mesh, scale_to_metres: scale }, blade, cut: { engage: "always" } }));
      const motion = fitted(join(data, "motions", `${hand}.csv`), box, 600);
      incise("convert", motion, "--config", config, "--out", capture);
      assertSameHashes(sessionOf(capture).replay(readFileSync(capture)), `${body}, ${hand}`);
    }
  }
});
