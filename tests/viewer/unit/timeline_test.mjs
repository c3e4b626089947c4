// Strokes over seconds: of a recording, and of the live session as the page has seen it.

import assert from "node:assert/strict";
import { test } from "node:test";
import { byId } from "./fake_page.mjs";
import { load } from "./modules.mjs";

const { barsOf, timeOf, revisionAt, strokeFrom, tickStep, LiveStrokes, BladeNames, cssColour } = await load(
  "timeline",
  "live_strokes",
  "blade_colours",
);

// Two blades at once, then a deformation, then the first blade again.
const revisions = {
  ms: [20, 40, 40, 60, 70, 900, 950],
  sources: [0, 0, 2, 0, 0, 0, 0],
  strokes: [1, 1, 1, 1, 0, 2, 2],
};

test("strokes are bars, also where two blades cut at once; deformations are none", () => {
  const bars = barsOf(revisions).map(({ source, stroke, first, last, from_ms, to_ms }) =>
    [source, stroke, first, last, from_ms, to_ms].join(),
  );
  assert.deepEqual(bars, ["0,1,1,4,20,60", "2,1,3,3,40,40", "0,2,6,7,900,950"]);
  assert.deepEqual(barsOf({ ms: [], sources: [], strokes: [] }), []);
});

test("each revision has its time, and each time the last revision that was there", () => {
  assert.deepEqual(
    [0, 1, 3, 7, 99].map((revision) => timeOf(revisions, revision)),
    [0, 20, 40, 950, 950],
  );
  assert.deepEqual(
    [0, 19, 20, 40, 500, 949, 950, 1e9].map((ms) => revisionAt(revisions, ms)),
    [0, 0, 1, 3, 5, 6, 7, 7],
  );
  assert.equal(timeOf({ ms: [], sources: [], strokes: [] }, 5), 0);
});

test("from stroke to stroke, forth and back, to the ends", () => {
  const bars = barsOf(revisions);
  const way = (step, from) => {
    const places = [from];
    for (let i = 0; i < 4; ++i) places.push(strokeFrom(bars, places.at(-1), step, 7));
    return places;
  };
  assert.deepEqual(way(1, 0), [0, 2, 5, 7, 7]);
  assert.deepEqual(way(-1, 7), [7, 5, 2, 0, 0]);
});

test("ticks are round, and no more than there is room for", () => {
  assert.deepEqual(
    [1, 900, 1000, 4001, 61_000].map((span) => tickStep(span, 8)),
    [100, 200, 200, 1000, 10_000],
  );
});

test("live strokes are those that this page has seen, without what was undone, and pauses are short", () => {
  const frames = [];
  globalThis.requestAnimationFrame = (frame) => frames.push(frame);
  const names = new BladeNames();
  names.read('{"blades": [{"source": 3, "name": "Dr. Li"}]}');
  const live = new LiveStrokes(names);
  const step = (stroke, revision, arrived_ms, source = 0) =>
    live.add({
      source,
      own: source === 0,
      stroke,
      revision,
      arrived_ms,
      heel: [],
      tip: [],
      ended: false,
      cutArea_m2: 1e-4,
    });
  const shown = () =>
    live.strokes.map(({ source, stroke, first, last, from_ms, to_ms }) => [
      source,
      stroke,
      first,
      last,
      from_ms,
      to_ms,
    ]);
  step(1, 1, 5000);
  step(1, 2, 5100);
  step(1, 3, 5050, 3); // of another blade, whose poses arrived before
  step(2, 4, 65_000);
  step(2, 5, 65_200);
  assert.deepEqual(shown(), [
    [0, 1, 1, 2, 0, 100],
    [3, 1, 3, 3, 100, 100],
    [0, 2, 4, 5, 600, 800],
  ]);
  assert.equal(frames.length, 1, "drawn once a frame");
  frames.pop()();
  assert.deepEqual(
    byId("blades").children.map((item) => item.children[1]),
    ["blade 1 (you)", "Dr. Li"],
  );
  assert.equal(byId("live-strokes").hidden, false);
  assert.ok(Math.abs(live.strokes[0].cutArea_m2 - 2e-4) < 1e-12);
  live.restart(3);
  step(2, 4, 70_000); // the same number again
  assert.deepEqual(
    shown().map((bar) => bar.slice(0, 4)),
    [
      [0, 1, 1, 2],
      [3, 1, 3, 3],
      [0, 2, 4, 4],
    ],
  );
  assert.ok(live.strokes[2].from_ms > 100);
  live.restart(0);
  assert.deepEqual(shown(), []);
  for (let n = 1; n <= 300; ++n) step(n, n, 80_000 + n);
  assert.equal(live.strokes.length, 200);
  assert.equal(live.strokes.at(-1).stroke, 300);
});

test("blades are called as the server says, else by their number; each has a colour of its own", () => {
  const names = new BladeNames();
  assert.equal(names.of(0), "blade 1");
  names.read('{"blades": [{"source": 0, "name": "mouse"}, {"source": 3, "name": "Dr. <b>Li</b>"}]}');
  names.read("not JSON");
  names.read("{}");
  assert.deepEqual(
    [0, 1, 3].map((source) => names.of(source)),
    ["mouse", "blade 2", "Dr. <b>Li</b>"],
  );
  const colours = [0, 1, 2, 3, 4, 5, 6, 7].map((source) => cssColour(source, false));
  assert.equal(new Set([...colours, cssColour(0, true)]).size, 9);
  assert.ok(colours.every((colour) => /^#[0-9a-f]{6}$/.test(colour)));
});
