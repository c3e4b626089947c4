// The page's controls without a browser: keys, figures, the player of recordings, and who may cut.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { beforeEach, test } from "node:test";
import { body, byId, focusOn, noticeTexts, press } from "./fake_page.mjs";
import { load } from "./modules.mjs";

const {
  answerTo,
  BladeName,
  Keys,
  Figures,
  Look,
  Replay,
  Operator,
  Measure,
  BodyMesh,
  Marks,
  allocateCorners,
  notice,
  Vector3,
  PerspectiveCamera,
} = await load(
  "drop",
  "blade_name",
  "keys",
  "figures",
  "look",
  "replay",
  "operator",
  "measure",
  "body_mesh",
  "marks",
  "corner_buffers",
  "notices",
  "../node_modules/three",
);

beforeEach(() => byId("notices").replaceChildren());

// Their timers must not keep the test alive.
for (const name of ["setInterval", "setTimeout"]) {
  const real = globalThis[name];
  globalThis[name] = (...args) => real(...args).unref();
}

// ---- The name of the page's blade ----

test("Esc in the name's field leaves it with the name as it was", () => {
  const stored = new Map();
  globalThis.localStorage = {
    getItem: (key) => stored.get(key) ?? null,
    setItem: (key, value) => stored.set(key, value),
  };
  const field = byId("blade-name");
  let left = 0;
  field.blur = () => {
    left += 1;
    field.dispatchEvent({ type: "change" }); // as some browsers do
  };
  const told = [];
  const name = new BladeName((text) => told.push(text));
  name.follow("a link's");
  field.value = "half a na";
  field.dispatchEvent({ type: "keydown", key: "e" });
  assert.equal(left, 0);
  field.dispatchEvent({ type: "keydown", key: "Escape" });
  assert.equal(left, 1);
  assert.equal(field.value, "a link's");
  assert.equal(name.inLink, "a link's");
  assert.equal(told.at(-1), "a link's");
  field.value = "left";
  field.dispatchEvent({ type: "change" });
  assert.equal(told.at(-1), "left");
  assert.equal(name.inLink, undefined);
});

// ---- Keys ----

const pressed = [];
let replaying = false;
new Keys([
  { keys: ["w"], shown: "W", does: "Wireframe", act: (key) => pressed.push(key) },
  { keys: ["ArrowLeft", "ArrowRight", "Shift ArrowLeft"], shown: "← →", does: "Turn", act: (key) => pressed.push(key) },
  { keys: ["n"], shown: "N", does: "On", act: (key) => pressed.push(key), needs: () => replaying },
]);
beforeEach(() => (pressed.length = 0));

test("a key works in either case and wherever the focus is, but for a control that wants it", () => {
  assert.ok(press("w") && press("W") && press("ArrowLeft"));
  assert.deepEqual(pressed, ["w", "w", "ArrowLeft"]);
  assert.equal(press("w", { ctrlKey: true }), false);
  assert.equal(press("ArrowLeft", { target: focusOn("input[type=range]") }), false);
  assert.equal(press("w", { target: focusOn("input[type=range]") }), true);
  assert.equal(press("w", { target: focusOn("input[type=password]") }), false);
  assert.equal(press("w", { target: focusOn("dialog") }), false);
  assert.equal(press("q"), false);
  pressed.length = 0;
  assert.ok(press("ArrowLeft", { shiftKey: true }) && press("W", { shiftKey: true }));
  assert.deepEqual(pressed, ["Shift ArrowLeft", "w"]);
  assert.equal(press("ArrowLeft", { shiftKey: true, target: focusOn("input[type=range]") }), false);
});

test("a key that needs something does nothing without it", () => {
  assert.equal(press("n"), false);
  replaying = true;
  assert.equal(press("n"), true);
});

test("a question mark opens the help, which lists every key once", () => {
  assert.ok(press("?"));
  assert.equal(byId("help-dialog").open, true);
  assert.deepEqual(
    byId("keys").children.map((row) => row.text),
    ["WWireframe", "←→Turn", "NOn", "?This help"],
  );
});

// ---- Labels ----

test("labels that would cover each other lie above or below one another, inside the picture", () => {
  const boxes = [];
  const pen = new Proxy(
    {},
    {
      get: (_, name) =>
        name === "roundRect" ? (...box) => boxes.push(box) : name === "measureText" ? () => ({ width: 40 }) : () => {},
      set: () => true,
    },
  );
  const canvas = { clientWidth: 200, clientHeight: 100, style: {}, getContext: () => pen };
  globalThis.devicePixelRatio ??= 1;
  globalThis.getComputedStyle ??= () => ({ getPropertyValue: () => "" });
  const camera = new PerspectiveCamera(50, 2, 0.1, 10);
  camera.position.z = 1;
  camera.updateMatrixWorld();
  const marks = new Marks(canvas, camera);
  marks.layers.push(() => {
    for (const name of ["one", "two", "three"]) marks.label(new Vector3(0, 0, 0), name);
    marks.label(new Vector3(-0.6, 0, 0), "elsewhere");
  });
  for (let drawing = 0; drawing < 2; ++drawing) {
    boxes.length = 0;
    marks.draw();
    assert.equal(boxes.length, 4);
    for (const [i, [x, y, width, height]] of boxes.entries()) {
      assert.ok(x >= 0 && y >= 0 && x + width <= 200 && y + height <= 100);
      for (const [u, v, w, h] of boxes.slice(0, i))
        assert.ok(x >= u + w || u >= x + width || y >= v + h || v >= y + height, "labels cover each other");
    }
    assert.equal(boxes[3][1], boxes[0][1], "a label with room keeps its height");
  }
});

test("a label lies beside what covers the picture, not under it", () => {
  const boxes = [];
  const pen = new Proxy(
    {},
    {
      get: (_, name) =>
        name === "roundRect" ? (...box) => boxes.push(box) : name === "measureText" ? () => ({ width: 40 }) : () => {},
      set: () => true,
    },
  );
  const canvas = { clientWidth: 200, clientHeight: 300, style: {}, getContext: () => pen };
  const camera = new PerspectiveCamera(50, 2 / 3, 0.1, 10);
  camera.position.z = 1;
  camera.updateMatrixWorld();
  const marks = new Marks(canvas, camera);
  marks.covered = () => [{ x: 100, y: 12, width: 90, height: 40 }];
  marks.layers.push(() => marks.label(new Vector3(0.1, 0.42, 0), "mouse"));
  marks.draw();
  const [[x, y, width]] = boxes;
  assert.ok(x + width > 100 && y >= 52, `${boxes}`);
});

// ---- Figures ----

const progress = {
  revision: 3,
  tets: 1000,
  triangles: 2,
  pieces: 2,
  hash: "00ff",
  hashAgrees: true,
  deltas: 0,
  bytes: 0,
};

test("the light of the hash is green where hashes agree, and only there", () => {
  const figures = new Figures();
  figures.showTrust(true);
  figures.show(progress);
  assert.equal(byId("hash-row").dataset.agrees, "true");
  assert.match(byId("hash-text").textContent, /agrees/);
  assert.equal(byId("tets").textContent, "1,000");
  figures.showTrust(false);
  figures.show(progress); // of a patch from before
  assert.equal(byId("hash-row").dataset.agrees, "false");
  assert.match(byId("hash-text").textContent, /differs/);
});

test("without a server the hash agrees with that of the session in the page", () => {
  const figures = new Figures(true);
  figures.showTrust(true);
  assert.equal(byId("hash-text").textContent, "Checked: it agrees with the session in this page");
  assert.doesNotMatch(byId("hash-row").title, /server/);
  figures.showTrust(false);
  assert.doesNotMatch(byId("hash-text").textContent, /server/);
});

test("without the server nothing is checked: the light is neutral, and as before when it is back", () => {
  const figures = new Figures();
  figures.showLive(false); // while the page connects
  figures.showTrust(true);
  assert.equal(byId("hash-row").dataset.agrees, "unknown");
  figures.showLive(true);
  assert.equal(byId("hash-row").dataset.agrees, "true");
  figures.showLive(false);
  assert.equal(byId("hash-row").dataset.agrees, "unknown");
  assert.match(byId("hash-text").textContent, /Not checked/);
  assert.equal(document.body.dataset.live, "no");
  figures.showTrust(false);
  figures.showLive(true);
  assert.equal(byId("hash-row").dataset.agrees, "false");
});

test("the frame budget is the share of the frames since the last look", () => {
  const figures = new Figures();
  const stats = (sum, count) =>
    JSON.stringify({ stages_us: { frame_work: { sum, count } }, frames: { rate_hz: 1000 }, backlog: { segments: 0 } });
  figures.showStats(stats(100_000, 1000));
  figures.showStats(stats(350_000, 1500)); // 500 us a frame of 1000
  assert.equal(byId("budget").textContent, "50%");
  figures.showStats("not JSON");
  assert.equal(byId("budget").textContent, "50%");
  assert.equal(byId("backlog").textContent, "none");
  assert.equal(byId("budget-chart").dataset.over, "false");
  figures.showStats(stats(350_000 + 1_050_000, 2500)); // 1,050 us a frame
  assert.deepEqual([byId("budget").textContent, byId("budget-chart").dataset.over], ["105%", "true"]);
});

test("the latency is marked above its line as long as it is shown", () => {
  const timers = [];
  const { setInterval } = globalThis;
  globalThis.setInterval = (look) => timers.push(look);
  const figures = new Figures();
  globalThis.setInterval = setInterval;
  const [look] = timers;
  const shown = () => [byId("latency").textContent, byId("latency-chart").dataset.over];
  figures.show(progress);
  figures.latency.expect(1000);
  figures.latency.drawn()(2449);
  for (let i = 0; i < 4; ++i) {
    look();
    assert.deepEqual(shown(), ["1,449 ms", "true"]);
  }
  look();
  assert.deepEqual(shown(), ["–", "false"]);
});

test("the latency goes when there are no poses any more", () => {
  const timers = [];
  const { setInterval } = globalThis;
  globalThis.setInterval = (look) => timers.push(look);
  const figures = new Figures();
  globalThis.setInterval = setInterval;
  const [look] = timers;
  const text = () => byId("latency").textContent;
  figures.show(progress);
  figures.latency.expect(100);
  figures.latency.drawn()(117);
  look();
  assert.equal(text(), "17 ms");
  for (let i = 0; i < 3; ++i) look();
  assert.equal(text(), "17 ms"); // between two poses of a slow hand
  look();
  assert.equal(text(), "–");
});

test("the rates of deltas and bytes are of a second, looked at every half", () => {
  const timers = [];
  const { setInterval } = globalThis;
  globalThis.setInterval = (look, every_ms) => timers.push([look, every_ms]);
  const figures = new Figures();
  globalThis.setInterval = setInterval;
  const [[look, every_ms]] = timers;
  assert.equal(every_ms, 500);
  figures.show({ ...progress, deltas: 10, bytes: 1024 });
  look();
  figures.show({ ...progress, deltas: 30, bytes: 1024 + 64 * 1024 });
  look();
  assert.equal(byId("deltas").textContent, "40/s, 128 KiB/s");
  look();
  assert.equal(byId("deltas").textContent, "none");
});

test("every control and every figure of the page has a tooltip", () => {
  const page = readFileSync(new URL("../../../client/viewer/index.html", import.meta.url), "utf8");
  const lines = page.replace(/<dialog.*?<\/dialog>/gs, "").split("\n");
  const controls = lines.filter((line) => /<(button|input|select|dt|a) |<dt>|class="chart"/.test(line));
  assert.ok(controls.length > 30);
  assert.deepEqual(
    controls.filter((line) => !/ title="[^"]{5,}"/.test(line) && !line.includes("/stats</a>.")),
    [],
  );
});

test("the figures' tooltips hold for a page without a server, too", () => {
  const page = readFileSync(new URL("../../../client/viewer/index.html", import.meta.url), "utf8");
  const figures = page.match(/<aside id="panel".*?<section id="live-strokes"/s)[0];
  assert.match(figures, /Frame budget used/);
  assert.doesNotMatch(figures, /server/);
});

test("a first look at the frames shows no share yet; areas are in square centimetres", () => {
  byId("budget").textContent = "-";
  const figures = new Figures();
  figures.showStats(JSON.stringify({ stages_us: { frame_work: { sum: 100_000, count: 1000 } } }));
  assert.equal(byId("budget").textContent, "-");
  figures.showCutArea(12.34e-4);
  assert.equal(byId("cut-area").textContent, "12.3");
});

// ---- Recordings ----

function player(facts = {}) {
  const sent = [];
  const replay = new Replay((message) =>
    sent.push(message.action + (message.revision === undefined ? "" : ` ${message.revision}`)),
  );
  const at = (revision, more) =>
    replay.show({
      capture: "a.capture",
      playing: false,
      speed: 1,
      revision,
      lastRevision: 9,
      text: "",
      ...facts,
      ...more,
    });
  byId("speed").value = "1";
  at(0);
  const scrub = byId("scrub");
  const drag = (revision) => {
    scrub.valueAsNumber = revision;
    scrub.oninput();
  };
  return { replay, sent, at, drag, letGo: () => scrub.onchange() };
}

test("scrubbing asks for one revision at a time, and for the last one that the hand was at", () => {
  const { sent, at, drag, letGo } = player();
  for (const revision of [5, 6, 7]) drag(revision);
  assert.deepEqual(sent, ["seek 5"]);
  at(5);
  assert.deepEqual(sent, ["seek 5", "seek 7"]);
  letGo();
  at(7);
  assert.deepEqual(sent, ["seek 5", "seek 7"]);
  assert.equal(byId("scrub").valueAsNumber, 7);
  at(8, { playing: true });
  assert.deepEqual(sent, ["seek 5", "seek 7"], "what plays on is not called back");
});

test("what plays stands still under the hand, and goes on when it lets go", () => {
  const { sent, at, drag, letGo } = player({ playing: true });
  drag(3);
  assert.deepEqual(sent, ["pause", "seek 3"]);
  at(3, { playing: false });
  drag(4);
  at(4, { playing: false });
  letGo();
  assert.deepEqual(sent, ["pause", "seek 3", "seek 4", "play"]);
});

test("a recording that ends takes its wishes with it", () => {
  const { replay, sent, drag } = player();
  drag(3);
  drag(4);
  replay.show(null);
  assert.equal(byId("player").hidden, true);
  assert.deepEqual(sent, ["seek 3"]);
});

test("another speed is sent to what plays, and only there", () => {
  const sent = [];
  const replay = new Replay((message) => sent.push(message));
  const facts = { capture: "a.capture", playing: false, speed: 1, revision: 0, lastRevision: 9, text: "" };
  replay.show(facts);
  byId("speed").value = "4";
  byId("speed").onchange();
  assert.deepEqual(sent, []);
  replay.show({ ...facts, playing: true });
  byId("speed").onchange();
  assert.deepEqual(sent, [{ kind: "replay", action: "play", speed: 4 }]);
  byId("speed").value = "1";
});

test("recordings are listed without their ending, and opened by their whole name", async () => {
  const sent = [],
    asked = [];
  globalThis.fetch = (url, options) => {
    asked.push([url, options.headers]);
    return Promise.resolve({ ok: true, json: () => Promise.resolve(["first.capture", "second.capture"]) });
  };
  await new Replay((message) => sent.push(message)).list("secret");
  assert.deepEqual(asked, [["captures", { Authorization: "Bearer secret" }]]);
  const buttons = byId("captures").children.map((item) => item.children[0]);
  assert.deepEqual(
    buttons.map((button) => button.textContent),
    ["first", "second"],
  );
  assert.equal(byId("recordings").hidden, false);
  buttons[1].click();
  assert.deepEqual(sent, [{ kind: "replay", action: "open", capture: "second.capture" }]);
});

// ---- Who may cut ----

function operator() {
  const sent = [];
  const camera = new PerspectiveCamera(40, 1, 0.01, 10);
  camera.position.set(0, 0, 1);
  camera.updateMatrixWorld();
  const blade = { move: () => {}, endStroke: () => {}, hide: () => {} };
  const stage = {
    camera,
    body: { raycast: () => 1 },
    centre: new Vector3(),
    bodySize_m: 0.2,
    blade: () => blade,
    marks: { layers: [], tools: [], draw: () => {} },
    draw: () => {},
    setOpen: () => {},
    hold: () => {},
    release: () => {},
    beforeBody: (heel) => heel,
    setTool: () => {},
  };
  for (const [id, value] of [
    ["depth", 1],
    ["length", 1],
    ["tilt", 0],
    ["open", 0.3],
  ])
    byId(id).valueAsNumber = value;
  const picture = byId("picture");
  picture.listeners = {};
  picture.clientWidth = picture.clientHeight = 400;
  picture.getBoundingClientRect = () => ({ left: 0, top: 0, width: 400, height: 400 });
  delete body.dataset.blade;
  const hands = new Operator(stage, (message) => sent.push(message));
  hands.meet("liver");
  hands.onBlade({ heel: [0, 0, 0], tip: [0, 0, -0.3], source: 0, engageButton: 0, maxSpeed_m_s: 1 });
  hands.onViewLink({ stage: "open", text: "" });
  hands.onBladeLink({ stage: "open", text: "" });
  sent.length = 0;
  let time = 0;
  const hand = (type, x, y) =>
    picture.dispatchEvent({
      type,
      pointerId: 1,
      button: 0,
      pointerType: "mouse",
      isPrimary: true,
      clientX: x,
      clientY: y,
      timeStamp: (time += 10),
    });
  const draw = () => {
    hand("pointerdown", 100, 200);
    for (let x = 110; x <= 300; x += 10) hand("pointermove", x, 200);
  };
  const poses = () => sent.filter((m) => m.kind === "poses").length;
  return { hands, sent, hand, draw, poses, letGo: () => hand("pointerup", 300, 200) };
}
const stalled = { stage: "stalled", text: "The server does not answer." };
const step = (cutArea_m2, ended) => ({ source: 0, own: true, heel: [0, 0, 0], tip: [0, 0, 0], ended, cutArea_m2 });

test("while the server does not answer the stroke in hand ends, and no other begins", () => {
  for (const stall of ["onViewLink", "onBladeLink"]) {
    byId("notices").replaceChildren();
    const { hands, draw, poses, letGo } = operator();
    draw();
    assert.equal(hands.mouse.cutting, true);
    const before = poses();
    hands[stall](stalled);
    assert.equal(hands.mouse.cutting, false);
    assert.equal(poses(), before + 1); // the release
    assert.match(noticeTexts()[0], /Your stroke ends here/);
    letGo();
    draw();
    letGo();
    assert.equal(poses(), before + 1);
    assert.ok(noticeTexts().some((text) => text.includes("Nothing is cut until it does")));
    hands[stall]({ stage: "open", text: "" });
    assert.ok(!noticeTexts().some((text) => text.includes("Nothing is cut until it does")));
    draw();
    assert.ok(poses() > before + 1);
  }
});

test("before the page has found the server a stroke says nothing of one that does not answer", () => {
  byId("notices").replaceChildren();
  const { hands, draw, letGo } = operator();
  hands.onViewLink({ stage: "connecting", text: "Connecting to the server…" });
  byId("notices").replaceChildren();
  draw();
  letGo();
  assert.deepEqual(noticeTexts(), []);
});

test("a stroke that cut nothing is said to have, when the server has cut it", () => {
  const { hands, draw, letGo } = operator();
  draw();
  hands.onOwnStep(step(0, true)); // the server began another stroke for it on the way
  assert.deepEqual(noticeTexts(), []);
  hands.onOwnStep(step(0, false));
  letGo();
  assert.deepEqual(noticeTexts(), []);
  hands.onOwnStep(step(0, true));
  assert.deepEqual(noticeTexts(), ["That stroke cut nothing. Draw across the liver."]);
});

test("a stroke that cut something says nothing", () => {
  const { hands, draw, letGo } = operator();
  draw();
  hands.onOwnStep(step(1e-4, false));
  letGo();
  hands.onOwnStep(step(0, true));
  assert.deepEqual(noticeTexts(), []);
});

test("what the stroke before cut does not count for the next", () => {
  const { hands, draw, letGo } = operator();
  draw();
  hands.onOwnStep(step(1e-4, false));
  letGo();
  hands.onOwnStep(step(0, true));
  draw();
  letGo();
  hands.onOwnStep(step(0, true));
  assert.deepEqual(noticeTexts(), ["That stroke cut nothing. Draw across the liver."]);
});

test("before there is a body the page says what it waits for, then what to do", () => {
  const { hands } = operator();
  const said = () => byId("hint-text").text;
  hands.waitsFor = "Waiting for the server to answer.";
  assert.equal(said(), "Waiting for the server to answer.");
  hands.setTool("measure");
  assert.equal(said(), "Waiting for the server to answer.");
  hands.setTool("cut");
  hands.waitsFor = "";
  assert.match(said(), /^Drag across the liver/);
});

test("the tilt is set in degrees, and a key opens the cuts or closes them", () => {
  const { hands } = operator();
  byId("tilt").valueAsNumber = 30;
  byId("tilt").value = "30";
  byId("tilt").dispatchEvent({ type: "input" });
  assert.ok(Math.abs(hands.mouse.tilt_rad - Math.PI / 6) < 1e-12);
  assert.equal(byId("tilt-text").textContent, "30°");
  hands.toggleOpen();
  assert.equal(byId("open").valueAsNumber, 0);
  hands.toggleOpen();
  assert.equal(byId("open").valueAsNumber, 0.3);
  hands.nudge("open", 0.05);
  assert.ok(Math.abs(byId("open").valueAsNumber - 0.35) < 1e-12);
  assert.equal(byId("open-text").textContent, "35%");
});

test("a blade that was held is taken again after a break, one that somebody took is not", () => {
  const { hands, sent } = operator();
  hands.onBladeLink({ stage: "waiting", text: "" });
  hands.meet("liver");
  assert.deepEqual(
    sent.filter((m) => m.kind === "take-blade").map((m) => m.takeOver),
    [true],
  );
  hands.onBladeLink({ stage: "ended", text: "", reason: "handed-over" });
  assert.equal(hands.tool, "turn");
  assert.match(noticeTexts()[0], /Another window has taken the blade/);
  hands.setTool("cut");
  assert.equal(sent.at(-1).takeOver, false);
  hands.meet("liver"); // of another length, while the blade is asked for
  assert.equal(sent.at(-1).takeOver, false);
});

test("a blade reaches through a body that it is long enough for, else up to its heel", () => {
  const { hands, sent } = operator();
  assert.equal(hands.mouse.depth_m, null);
  hands.onBladeLink({ stage: "waiting", text: "" });
  hands.meet("liver");
  assert.ok(Math.abs(sent.at(-1).length_m - 0.3) < 1e-9, "1.5 times the body");
  byId("length").valueAsNumber = 0.2;
  hands.meet("liver");
  assert.ok(Math.abs(hands.mouse.depth_m - 0.97 * 0.06) < 1e-9, `${hands.mouse.depth_m} m`);
});

test("a simulation closes Open, unless the hand has set it", () => {
  const { hands } = operator();
  hands.onDeforms();
  assert.equal(byId("open").valueAsNumber, 0);
  const { hands: others } = operator();
  byId("open").valueAsNumber = 0.5;
  byId("open").dispatchEvent({ type: "input" });
  others.onDeforms();
  assert.equal(byId("open").valueAsNumber, 0.5);
});

test("after a recording Open is where the live body had it", () => {
  const { hands } = operator();
  byId("open").valueAsNumber = 0.3;
  hands.onReplay(true);
  hands.onDeforms();
  assert.equal(byId("open").valueAsNumber, 0);
  hands.onReplay(false);
  assert.equal(byId("open").valueAsNumber, 0.3);
  hands.onReplay(true);
  byId("open").valueAsNumber = 0.5;
  byId("open").dispatchEvent({ type: "input" }); // chosen
  hands.onReplay(false);
  assert.equal(byId("open").valueAsNumber, 0.5);
});

test("in a replay there is nothing to cut", () => {
  const { hands, sent } = operator();
  hands.onReplay(true);
  assert.equal(hands.tool, "turn");
  assert.equal(sent.at(-1).kind, "release-blade");
  hands.setTool("cut");
  assert.equal(hands.tool, "turn");
  assert.deepEqual(noticeTexts(), ["A recording cannot be cut."]);
  hands.onReplay(false);
  assert.equal(hands.tool, "cut");
  assert.deepEqual(noticeTexts(), []); // it no longer holds
});

test("after measuring the hand has the tool that it had before, unless a replay has come or gone", () => {
  const { hands } = operator();
  for (const tool of ["cut", "turn"]) {
    hands.setTool(tool);
    hands.setTool("measure");
    hands.setTool("measure");
    hands.endMeasuring();
    assert.equal(hands.tool, tool);
    hands.endMeasuring();
    assert.equal(hands.tool, tool);
  }
  hands.setTool("cut");
  hands.setTool("measure");
  hands.onReplay(true);
  hands.setTool("measure");
  hands.endMeasuring();
  assert.equal(hands.tool, "turn");
  hands.setTool("measure");
  hands.onReplay(false);
  hands.endMeasuring();
  assert.equal(hands.tool, "cut");
});

test("the same notice is shown once, and its button does what it says", () => {
  let done = 0;
  notice("There.", "Do it", () => ++done);
  notice("There.", "Do it", () => ++done);
  assert.deepEqual(noticeTexts(), ["There."]);
  byId("notices").children[0].children[1].click();
  assert.equal(done, 1);
  assert.deepEqual(noticeTexts(), []);
});

// ---- The panel ----

test("the panel's button says whether the panel is open, which it is at first in a wide window", () => {
  Object.assign(globalThis, {
    localStorage: { getItem: () => null, setItem: () => {} },
    getComputedStyle: () => ({ getPropertyValue: () => "" }),
    innerHeight: 800,
  });
  document.documentElement = { dataset: {} };
  const stage = { setCover: () => {}, setInk: () => {}, marks: { tools: [] } };
  const button = byId("panel-toggle");
  for (const [width, open] of [
    [1400, true],
    [800, false],
  ]) {
    globalThis.innerWidth = width;
    new Look(
      stage,
      () => {},
      () => {},
    );
    const shown = (now) => {
      assert.equal(body.dataset.panel, now ? "open" : "closed");
      assert.equal(button.attributes["aria-expanded"], String(now));
    };
    shown(open);
    button.click();
    shown(!open);
    button.click();
    shown(open);
  }
});

// ---- Measuring ----

/** A square of 0.1 m in two triangles, the second a cut face; a click at (x, y) meets the surface there, in metres. */
function measuring() {
  const body = new BodyMesh();
  const corners = allocateCorners(2);
  corners.positions.set([0, 0, 1, 0.1, 0, 1, 0.1, 0.1, 1, 0, 0, 1, 0.1, 0.1, 1, 0, 0.1, 1]);
  corners.ids.set([4, 8]);
  corners.facts[12] = 1;
  body.replace(2, 8, corners);
  const canvas = byId("measured");
  canvas.listeners = {};
  canvas.getBoundingClientRect = () => ({ left: 0, top: 0, width: 200, height: 200 });
  const asked = [];
  const pick = (x, y) => {
    const [u, v] = [(x + 1) / 2, (1 - y) / 2]; // of the square
    if (u > 0.9) return null;
    const weights = u > v ? [1 - u, u - v, v] : [1 - v, u, v - u];
    return { slot: Number(u <= v), halfFace: u > v ? 4 : 8, weights, distance: 1, isCut: u <= v };
  };
  const stage = { body, openNow: 0, pick, draw: () => {} };
  const measure = new Measure(canvas, stage, (halfFace) => asked.push(halfFace));
  const hand = (type, x, y) =>
    canvas.dispatchEvent({ type, button: 0, isPrimary: true, clientX: 2000 * x, clientY: 2000 * y });
  const click = (x, y, [dx, dy] = [0, 0]) => {
    hand("pointerdown", x, y);
    hand("pointerup", x + dx, y + dy);
  };
  return { body, corners, measure, click, asked };
}

test("two clicks give a length, further ones the total; a drag and a click beside the body none", () => {
  const { measure, click } = measuring();
  click(0.02, 0.01);
  assert.equal(measure.shown, false); // the mode is off
  measure.active = true;
  click(0.02, 0.01);
  assert.deepEqual(measure.labels, []);
  click(0.06, 0.04);
  assert.deepEqual(measure.labels, ["50.0 mm"]);
  click(0.08, 0.04);
  assert.deepEqual(measure.labels, ["70.0 mm"]);
  click(0.02, 0.01, [0.01, 0]); // 20 pixels
  click(0.095, 0.01);
  assert.deepEqual(measure.labels, ["70.0 mm"]);
  measure.clear();
  assert.deepEqual(measure.labels, []);
});

test("measured points move with the body, and go with their triangle", () => {
  const { body, corners, measure, click } = measuring();
  measure.active = true;
  click(0.02, 0.01);
  click(0.06, 0.04);
  for (let i = 0; i < 9; ++i) corners.positions[i] *= 2;
  body.patch(Uint32Array.of(0), 2, corners);
  measure.follow();
  assert.deepEqual(measure.labels, ["100.0 mm"]);
  assert.deepEqual(noticeTexts(), []);
  corners.ids[0] = 12;
  body.patch(Uint32Array.of(0), 2, corners);
  measure.follow();
  assert.deepEqual(measure.labels, []);
  assert.equal(measure.shown, false);
  assert.match(noticeTexts()[0], /its triangle was cut or removed/);
});

test("a click on a cut face asks for its area, which follows the body", () => {
  const { measure, click, asked } = measuring();
  measure.active = true;
  click(0.01, 0.02);
  assert.deepEqual(asked, [8]);
  measure.onArea(4, 9); // of a face that is not asked for any more
  assert.deepEqual(measure.labels, []);
  measure.onArea(8, 12.5e-4);
  assert.deepEqual(measure.labels, ["12.50 cm²"]);
  measure.follow();
  assert.deepEqual(asked, [8, 8]);
  measure.onArea(8, 13e-4);
  click(0.06, 0.04);
  assert.deepEqual(measure.labels, ["53.9 mm"]); // the last click was on skin
});

// ---- Files that are dropped ----

test("a mesh that is dropped is refused with what to do instead, and the configuration for it", () => {
  const { text, config } = answerTo(["skin.png", "My liver.v2.STL"], false);
  assert.match(text, /My liver\.v2\.STL is not opened here.*run incised --config "My liver\.v2\.json", which fills it/);
  assert.deepEqual(
    [config.name, JSON.parse(config.content)],
    ["My liver.v2.json", { mesh: { path: "My liver.v2.STL" } }],
  );
  assert.doesNotMatch(answerTo(["a.vtu"], false).text, /fills/);
  assert.equal(answerTo([".obj"], false).config.name, "body.json");
  const local = answerTo(["a.ply"], true);
  assert.equal(local.config, undefined);
  assert.match(local.text, /has no server/);
});

test("other files that are dropped are said not to be meshes", () => {
  assert.match(answerTo(["a.capture"], false).text, /capture\.library/);
  assert.match(answerTo(["a.mtl"], false).text, /belongs to a surface/);
  for (const name of ["notes.txt", "stl", "a."])
    assert.match(answerTo([name], false).text, /not a mesh that incised reads.*\.stl.*\.vtu/);
});
