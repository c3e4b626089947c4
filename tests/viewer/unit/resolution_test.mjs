// The rule by which a moving picture gets fewer or more pixels.

import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./modules.mjs";

const { Resolution, kScales } = await load("resolution");

/** Frames whose time depends on the scale; the scales that it went through. */
function run(resolution, frames, time_ms) {
  const seen = [resolution.scale];
  for (let i = 0; i < frames; ++i) {
    const before = resolution.scale;
    const changed = resolution.took(time_ms(resolution.scale, i));
    assert.equal(changed, resolution.scale !== before);
    if (changed) seen.push(resolution.scale);
  }
  return seen;
}

test("quick frames keep all pixels", () => {
  assert.deepEqual(
    run(new Resolution(false), 1000, () => 16.7),
    [1],
  );
});

test("slow frames cost pixels step by step, to the last scale and no further", () => {
  assert.deepEqual(
    run(new Resolution(false), 200, () => 60),
    kScales,
  );
});

test("it stops where 30 pictures a second are reached", () => {
  assert.deepEqual(
    run(new Resolution(false), 1000, (scale) => (scale > 0.6 ? 50 : 33.3)),
    kScales.slice(0, 4),
  );
});

test("a single hitch is no trend", () => {
  assert.deepEqual(run(new Resolution(false), 1000, (_, i) => (i % 100 === 50 ? 5000 : 16.7)).slice(0, 2), [1]);
});

test("a machine without a graphics card begins low, and gets more when it turns out to be quick", () => {
  const resolution = new Resolution(true);
  assert.ok(resolution.scale < 1);
  run(resolution, 1000, () => 16.7);
  assert.equal(resolution.scale, 1);
});

test("a step that is too much is tried ever more seldom", () => {
  const changes = [];
  const resolution = new Resolution(true);
  const low = resolution.scale;
  for (let i = 0; i < 3000; ++i) {
    if (resolution.took(resolution.scale > low ? 50 : 16.7) && resolution.scale > low) changes.push(i);
  }
  assert.ok(changes.length >= 3 && changes.length < 7, `${changes.length} tries`);
  for (let i = 2; i < changes.length; ++i) {
    assert.ok(changes[i] - changes[i - 1] > 1.8 * (changes[i - 1] - changes[i - 2]), changes.join());
  }
});

test("steps down that no step up led to do not make it wait longer", () => {
  const resolution = new Resolution(false);
  run(resolution, 200, () => 60);
  assert.equal(resolution.scale, kScales.at(-1));
  run(resolution, 600, () => 16.7);
  assert.equal(resolution.scale, 1);
});
