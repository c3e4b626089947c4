// How fast the core is in WebAssembly, compared with native on the same machine: the same cuts, the same hashes.
//
//   node tests/bench/wasm_ratio.mjs [--rounds N] [--json]     after ./dev build
//
// Native is what `incise cut` reports as cut_time_us.all. Both are wall-clock times, taken in turn; the shortest of the rounds counts. The
// first time in a fresh module is given as well: an engine compiles the code better once it is hot.

import assert from "node:assert/strict";
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { parseArgs } from "node:util";
import { directory, incise, sessionOf } from "../wasm/session.mjs";

const { values: options } = parseArgs({
  options: { rounds: { type: "string", default: "5" }, json: { type: "boolean", default: false } },
});
const rounds = Number(options.rounds);
assert.ok(Number.isInteger(rounds) && rounds > 0, `--rounds: found ${options.rounds}; accepted are whole numbers from 1`);

/** A straight pass of the blade, which points down from z, along y. */
function pass(name, { x, from, to, z, lines }) {
  const rows = ["t_s,x_m,y_m,z_m,qw,qx,qy,qz,button"];
  for (let i = 0; i <= lines; ++i)
    rows.push([i / 125, x, from + ((to - from) * i) / lines, z, 1, 0, 0, 0, i < lines ? 1 : 0].join());
  const file = join(directory, `${name}.csv`);
  writeFileSync(file, `${rows.join("\n")}\n`);
  return file;
}

const results = [];
for (const tets of [16_000, 150_000]) {
  const mesh = join(directory, `liver${tets}.node`);
  incise("phantom", "liver", "--size", tets, "--out", mesh);
  const info = JSON.parse(incise("info", mesh, "--json"));
  const [min, max] = [info.box_m.min, info.box_m.max];
  const at = (k, share) => min[k] + share * (max[k] - min[k]);
  const size = max.map((m, k) => m - min[k]);
  const cuts = {
    "right through": { x: at(0, 0.45), from: at(1, -0.1), to: at(1, 1.1), z: at(2, 1.2), lines: 120 },
    corner: { x: at(0, 0.03), from: at(1, -0.1), to: at(1, 1.1), z: at(2, 1.2), lines: 120 },
  };
  for (const [cut, way] of Object.entries(cuts)) {
    const name = `${cut.replace(" ", "_")}_${tets}`;
    const config = join(directory, `${name}.json`);
    writeFileSync(config, JSON.stringify({ mesh: { path: mesh }, blade: { heel: [0, 0, 0], tip: [0, 0, -1.5 * size[2]] } }));
    const capture = join(directory, `${name}.capture`);
    incise("convert", pass(name, way), "--config", config, "--out", capture);
    const bytes = readFileSync(capture);
    const session = sessionOf(capture);
    const native = [];
    const wasm = [];
    let report;
    for (let round = 0; round < rounds; ++round) {
      report = JSON.parse(
        incise("cut", "--mesh", mesh, "--poses", capture, "--config", config, "--out", join(directory, "x.vtu"), "--json"),
      );
      native.push(report.cut_time_us.all / 1000);
      const replayed = session.replay(bytes);
      assert.equal(replayed.state_hash, report.state_hash);
      wasm.push(replayed.ms);
    }
    const best = { native: Math.min(...native), wasm: Math.min(...wasm) };
    results.push({
      tets: report.tets_before,
      cut,
      cut_faces: report.cut_faces,
      native_ms: best.native,
      wasm_ms: best.wasm,
      wasm_first_ms: wasm[0],
      ratio: best.wasm / best.native,
    });
  }
}

if (options.json) {
  console.log(JSON.stringify(results, null, 2));
} else {
  console.table(
    results.map((r) => ({
      ...r,
      ...Object.fromEntries(["native_ms", "wasm_ms", "wasm_first_ms", "ratio"].map((k) => [k, Number(r[k].toFixed(2))])),
    })),
  );
}
