// The page's own connections to a session in the browser: what they show, what is recorded, and what happens when it fails.

import assert from "node:assert/strict";
import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { load } from "../viewer/unit/modules.mjs";
import { directory, incise, root, sessionFiles, wasmDirectory } from "./session.mjs";

const { Blade, SessionHost, Viewer, localSession, askAdmin } = await load(
  "blade",
  "session_host",
  "viewer",
  "local_session",
  "reset",
);

const capture = join(root, "tests/replay/planar_conforming.capture");
const files = {
  ...Object.fromEntries(Object.entries(sessionFiles(capture)).map(([k, v]) => [k === "body" ? "body.bin" : "header.capture", v])),
  "incise.wasm": readFileSync(join(wasmDirectory, "incise.wasm")),
  "planar.capture": readFileSync(capture),
};

const later = (what) => setImmediate(what);
const hosts = [];

/** A worker on this thread: its messages take as long as they would, a turn of the event loop. */
class NearWorker {
  constructor() {
    const load = async (url) => {
      const name = url.slice(url.lastIndexOf("/") + 1);
      if (!files[name]) throw new Error(`${name}: 404`);
      return Uint8Array.from(files[name]);
    };
    this.host = new SessionHost((message) => later(() => !this.over && this.onmessage({ data: message })), load);
    hosts.push(this.host);
  }
  postMessage(message) {
    const copy = structuredClone(message);
    later(() => !this.over && this.host.take(copy));
  }
  terminate() {
    this.over = true;
    this.host.stop();
  }
}

const until = async (condition, what) => {
  const end = Date.now() + 60_000;
  while (!condition()) {
    assert.ok(Date.now() < end, `waited in vain for ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 5));
  }
};

let sessions = 0;
/** A page's worker without the page: viewer and blade at a session of their own. */
async function open(t) {
  const url = `http://page/session${++sessions}/`;
  const seen = { progress: null, notices: [], replay: null, facts: [], links: [], blade: null };
  let viewer;
  const post = (message) => {
    if (message.progress) seen.progress = message.progress;
    if (message.kind === "patch" || message.kind === "geometry") later(() => viewer.feed.applied());
    if (message.kind === "notice") seen.notices.push(message.text);
    if (message.kind === "replay") seen.replay = message.facts;
    if (message.kind === "facts") seen.facts.push(message.facts);
    if (message.kind === "blade") seen.blade = message.facts;
    if (message.kind === "link") seen.links.push(message);
  };
  const session = localSession(url, () => new NearWorker());
  const blade = new Blade(post);
  viewer = new Viewer(blade, post);
  viewer.connect(url, "");
  blade.take(url, "", false, 2);
  t.after(() => {
    blade.release();
    viewer.link.end();
    for (const host of hosts.splice(0)) host.stop();
  });
  await until(() => seen.progress && seen.blade, "the body and the blade");
  return { url, seen, session, blade, viewer };
}

let now_ms = 1000;
/** A straight pass of the blade through the body, across x at this place. */
function cut({ blade, seen }, x, lines = 40) {
  const { min, max } = seen.facts.at(-1);
  const from = min[1] - 0.2 * (max[1] - min[1]);
  const way = 1.4 * (max[1] - min[1]);
  const rows = [];
  for (let i = 0; i <= lines; ++i)
    rows.push((now_ms += 20), x, from + (way * i) / lines, max[2] + 0.2 * (max[2] - min[2]), 1, 0, 0, 0, i < lines ? 1 : 0);
  blade.send(Float64Array.from(rows));
}

async function quiet(page) {
  let last = -1;
  await until(() => page.seen.progress.revision > 0, "a cut");
  while (last !== page.seen.progress.revision) {
    last = page.seen.progress.revision;
    await new Promise((resolve) => setTimeout(resolve, 200));
  }
}

/** What the native program says of a recording. */
function replayed(bytes) {
  const file = join(directory, "saved.capture");
  writeFileSync(file, bytes);
  return JSON.parse(incise("replay", file, "--mesh", join(root, "tests/replay/body"), "--verify", "--json"));
}

const middle = ({ seen }) => (seen.facts[0].min[0] + seen.facts[0].max[0]) / 2;

test("what is cut is shown, checked and recorded", async (t) => {
  const page = await open(t);
  assert.equal(page.seen.progress.revision, 0);
  cut(page, middle(page));
  await quiet(page);
  const { progress } = page.seen;
  assert.equal(progress.hashAgrees, true);
  assert.equal(progress.pieces, 2);
  const report = replayed(await page.session.capture());
  assert.deepEqual([report.state_hash, report.batches], [progress.hash, progress.revision]);
  cut(page, middle(page) + 0.13 * (page.seen.facts[0].max[0] - middle(page)));
  await until(() => page.seen.progress.revision > progress.revision, "the second cut");
  await quiet(page);
  assert.equal(replayed(await page.session.capture()).state_hash, page.seen.progress.hash);
  assert.deepEqual(page.seen.notices, []);
});

test("strokes are undone one after the other, and the recording replays without them", async (t) => {
  const page = await open(t);
  const hashes = [page.seen.progress.hash];
  for (const aside of [0, 0.4]) {
    cut(page, middle(page) + aside * (page.seen.facts[0].max[0] - middle(page)));
    await until(() => page.seen.progress.hash !== hashes.at(-1), "a cut");
    await quiet(page);
    hashes.push(page.seen.progress.hash);
  }
  for (const wanted of [hashes[1], hashes[0]]) {
    assert.equal(page.blade.undo(), true);
    await until(() => page.seen.progress.hash === wanted, "the state before the stroke");
    assert.equal(page.seen.progress.hashAgrees, true);
  }
  assert.deepEqual(page.seen.notices, []);
  page.blade.undo();
  await until(() => page.seen.notices.length > 0, "a refusal");
  assert.match(page.seen.notices[0], /there is no stroke to undo/);
  cut(page, middle(page));
  await until(() => page.seen.progress.revision > 0, "a cut");
  await quiet(page);
  assert.equal(page.seen.progress.hash, hashes[1]);
  assert.equal(replayed(await page.session.capture()).state_hash, hashes[1]);
});

test("a reset gives the uncut body, and the recording goes on behind it with the blades that are held", async (t) => {
  const page = await open(t);
  const uncut = page.seen.progress.hash;
  cut(page, middle(page));
  await quiet(page);
  askAdmin(page.url, "", "reset", () => {});
  await until(() => page.seen.progress.revision === 0, "the uncut body");
  assert.equal(page.seen.progress.hash, uncut);
  cut(page, middle(page) + 0.001);
  await quiet(page);
  assert.equal(replayed(await page.session.capture()).state_hash, page.seen.progress.hash);
});

test("a recording is replayed on a copy", async (t) => {
  const page = await open(t);
  cut(page, middle(page));
  await quiet(page);
  const own = page.seen.progress;
  const control = (action, more = {}) => page.viewer.controlReplay({ kind: "replay", action, ...more });
  const native = JSON.parse(incise("replay", capture, "--json"));
  control("open", { capture: "planar.capture" });
  await until(() => page.seen.replay?.capture === "planar.capture" && page.seen.progress.revision === 0, "the recording");
  control("seek", { revision: native.batches });
  await until(() => page.seen.progress.hash === native.state_hash, "its end");
  assert.equal(page.seen.progress.hashAgrees, true);
  control("seek", { revision: 2 });
  await until(() => page.seen.progress.revision === 2, "an earlier place");
  control("step");
  await until(() => page.seen.progress.revision === 3, "the next one");
  control("play", { speed: 1000 });
  await until(() => page.seen.progress.hash === native.state_hash && !page.seen.replay.playing, "its end, played");
  control("close");
  await until(() => page.seen.replay === null && page.seen.progress.hash === own.hash, "the live body");

  page.session.addRecording("own.capture", await page.session.capture());
  control("open", { capture: "own.capture" });
  await until(() => page.seen.replay?.capture === "own.capture", "the own recording");
  control("seek", { revision: own.revision });
  await until(() => page.seen.progress.hash === own.hash, "its end");
  control("open", { capture: "none.capture" });
  await until(() => page.seen.notices.length === 1, "a refusal");
  assert.match(page.seen.notices[0], /none\.capture could not be loaded: none\.capture: 404/);
  await until(() => page.seen.replay === null && page.seen.progress.hash === own.hash, "the live body");
});

test("a blade is held by one, and can be taken over", async (t) => {
  const page = await open(t);
  const links = [];
  const other = new Blade((message) => message.kind === "link" && links.push(message.state));
  t.after(() => other.release());
  other.take(page.url, "", false, 1);
  await until(() => links.some((state) => state.reason === "taken"), "a refusal");
  other.take(page.url, "", true, 1);
  await until(() => links.at(-1).stage === "open", "the blade");
  await until(() => page.seen.links.some(({ state }) => state.reason === "handed-over"), "the first one's end");
});

test("a session that fails says why, leaves its recording, and begins again", async (t) => {
  const page = await open(t);
  const failures = [];
  page.session.onFailed = (why, recording) => failures.push({ why, recording });
  cut(page, middle(page));
  await quiet(page);
  const { revision } = page.seen.progress;
  // As an abort in the middle of its work.
  const { session } = hosts.at(-1);
  const work = () => {
    session.printed = "the check failed: 2 < 1\n";
    throw new WebAssembly.RuntimeError("unreachable");
  };
  session.exports = { ...session.exports, incise_work: work };
  cut(page, middle(page) + 0.02);
  await until(() => failures.length === 1, "the failure");
  assert.equal(failures[0].why, "the check failed: 2 < 1");
  assert.ok(replayed(failures[0].recording).batches >= revision);
  await until(() => page.seen.progress.revision === 0, "the uncut body");
  assert.ok(page.seen.links.some(({ state }) => /The session failed: the check failed/.test(state.text)));
  await until(() => page.seen.links.filter(({ which, state }) => which === "blade" && state.stage === "open").length > 1, "the blade");
  cut(page, middle(page));
  await quiet(page);
  assert.equal(page.seen.progress.hashAgrees, true);
});
