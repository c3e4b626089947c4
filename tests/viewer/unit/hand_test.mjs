// How the page turns the pointer into the mouse's blade, and measures the time until the user sees the effect.

import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./modules.mjs";

const { MouseBlade, Latency, BodyMesh, allocateCorners, PerspectiveCamera, Quaternion, Vector3 } = await load(
  "mouse_blade",
  "latency",
  "body_mesh",
  "corner_buffers",
  "../node_modules/three",
);

const kLength_m = 0.3,
  kSkin_m = 0.02;

/** A skin at z = kSkin_m, 0.2 m wide, seen straight from above; and a hand that draws over the picture of 400 x 400 pixels. */
function scene() {
  const body = new BodyMesh();
  const corners = allocateCorners(2);
  corners.positions.set([
    -0.1,
    -0.1,
    kSkin_m,
    0.1,
    -0.1,
    kSkin_m,
    0.1,
    0.1,
    kSkin_m,
    -0.1,
    -0.1,
    kSkin_m,
    0.1,
    0.1,
    kSkin_m,
    -0.1,
    0.1,
    kSkin_m,
  ]);
  body.replace(2, 8, corners);
  const camera = new PerspectiveCamera(40, 1, 0.01, 10);
  camera.position.set(0, 0, 1);
  camera.lookAt(0, 0, 0);
  camera.updateMatrixWorld();
  const listeners = {};
  const canvas = {
    clientWidth: 400,
    clientHeight: 400,
    addEventListener: (name, f) => (listeners[name] = f),
    setPointerCapture: () => {},
    getBoundingClientRect: () => ({ left: 0, top: 0, width: 400, height: 400 }),
  };
  const poses = [],
    said = [];
  const mouse = new MouseBlade(
    canvas,
    { camera, body, centre: new Vector3(), bodySize_m: 0.3 },
    {
      poses: (numbers) => {
        for (let i = 0; i < numbers.length; i += 9) poses.push(poseOf(numbers.subarray(i, i + 9)));
      },
      moved: () => {},
      hovered: () => said.push("hovered"),
      aimed: () => {},
      refused: () => said.push("refused"),
      strokeBegan: () => said.push("began"),
      strokeEnded: (sent) => said.push(sent ? "sent" : "nothing"),
    },
  );
  mouse.facts = { heel: [0, 0, 0], tip: [0, 0, -kLength_m], source: 0, engageButton: 0, maxSpeed_m_s: 1 };
  mouse.enabled = true;
  let time = 1000;
  const hand = (name, x, y, step_ms = 8, more = {}) =>
    listeners[name]({
      pointerId: 1,
      button: 0,
      pointerType: "mouse",
      isPrimary: true,
      clientX: x,
      clientY: y,
      timeStamp: (time += step_ms),
      ...more,
    });
  const draw = (from, to, steps = 20) => {
    hand("pointerdown", ...from);
    for (let i = 1; i <= steps; ++i)
      hand("pointermove", from[0] + ((to[0] - from[0]) * i) / steps, from[1] + ((to[1] - from[1]) * i) / steps);
    hand("pointerup", ...to);
  };
  return { mouse, poses, said, hand, draw };
}

function poseOf([time_ms, x, y, z, w, i, j, k, buttons]) {
  const turn = new Quaternion(i, j, k, w);
  const heel = new Vector3(x, y, z);
  return { time_ms, heel, tip: new Vector3(0, 0, -kLength_m).applyQuaternion(turn).add(heel), turn, buttons };
}

const near = (a, b, tolerance) => assert.ok(Math.abs(a - b) <= tolerance, `${a}, wanted ${b}`);

test("at a limited depth the tip is so deep below the skin, and the heel above it", () => {
  const { mouse, poses, draw } = scene();
  mouse.depth_m = 0.03;
  draw([140, 200], [260, 200]);
  const cutting = poses.filter((p) => p.buttons !== 0);
  assert.ok(cutting.length > 20);
  for (const { tip, heel } of cutting) {
    near(tip.z, kSkin_m - 0.03, 0.005);
    assert.ok(heel.z > kSkin_m, `heel at ${heel.z}`);
  }
});

test("right through, the blade's middle is in the body's middle", () => {
  const { poses, draw } = scene();
  draw([140, 200], [260, 200]);
  for (const { tip, heel } of poses) near(tip.z + heel.z, 0, 0.03);
});

test("with a section, a stroke begins on what is drawn, and right through the edge stays on that side", () => {
  const { mouse, poses, said, draw } = scene();
  const section = (plane) => {
    poses.length = 0;
    mouse.stage.plane = plane;
    mouse.stage.body.setSection(plane);
  };
  section([0, 0, 1, 0]); // hides the skin
  draw([140, 200], [260, 200]);
  assert.deepEqual([poses.length, said], [0, ["began", "nothing"]]);
  section([0, 0, 1, 0.05]);
  draw([140, 200], [260, 200]);
  assert.ok(poses.length > 20);
  for (const { heel } of poses) assert.ok(heel.z < 0.05 + 1e-6, `heel at ${heel.z}`);
  section([0, 0, -1, 0]); // seen from the side that is drawn
  for (const [depth_m, tilt_rad] of [
    [null, 0],
    [null, 0.4],
    [0.1, 0],
  ]) {
    Object.assign(mouse, { depth_m, tilt_rad });
    poses.length = 0;
    draw([140, 200], [260, 200]);
    assert.ok(poses.length > 20);
    for (const { tip } of poses) assert.ok(tip.z > -1e-6, `tip at ${tip.z}`);
  }
  section([0, 0, 1, 0.05]);
  Object.assign(mouse, { depth_m: null, tilt_rad: 0.4 });
  draw([140, 200], [260, 200]);
  assert.ok(poses.length > 20);
  for (const { heel } of poses) assert.ok(heel.z < 0.05 + 1e-6, `heel at ${heel.z}`);
  section(null);
  mouse.tilt_rad = 0;
  draw([140, 200], [260, 200]);
  for (const { tip, heel } of poses) near(tip.z + heel.z, 0, 0.03);
});

test("the blade goes where the hand does, along the line of sight", () => {
  const { poses, draw } = scene();
  draw([140, 200], [260, 220]);
  const half = Math.tan((20 * Math.PI) / 180);
  for (const [pose, px] of [
    [poses[0], [140, 200]],
    [poses.at(-1), [260, 220]],
  ]) {
    const along = pose.tip.clone().sub(pose.heel).normalize();
    const wanted = new Vector3((px[0] / 200 - 1) * half, (1 - px[1] / 200) * half, -1).normalize();
    assert.ok(along.angleTo(wanted) < 1e-6, `${along.toArray()}, wanted ${wanted.toArray()}`);
  }
  assert.ok(poses.every((p) => Math.abs(p.turn.length() - 1) < 1e-9));
});

test("a tilt leans the blade by its angle", () => {
  const { mouse, poses, draw } = scene();
  mouse.tilt_rad = Math.PI / 6;
  draw([200, 140], [200, 260]);
  const along = poses[0].tip.clone().sub(poses[0].heel);
  near(Math.atan2(-along.x, -along.z), Math.PI / 6, 0.02);
});

test("times rise, no step is faster than the server takes, and the last pose lets go", () => {
  const { poses, draw, mouse } = scene();
  draw([100, 200], [300, 200], 2); // a flick: 0.7 m/s and more
  for (let i = 1; i < poses.length; ++i) {
    const seconds = (poses[i].time_ms - poses[i - 1].time_ms) / 1000;
    assert.ok(seconds > 0, `pose ${i}`);
    assert.ok(poses[i].tip.distanceTo(poses[i - 1].tip) / seconds <= 0.41 * mouse.facts.maxSpeed_m_s, `pose ${i}`);
    assert.ok(seconds < 0.04 || poses[i].buttons === 0, `pose ${i} comes after ${seconds} s`);
  }
  assert.equal(poses.at(-1).buttons, 0);
  assert.ok(poses.slice(0, -1).every((p) => p.buttons === 1));
});

test("a click is no stroke, and a stroke that never meets the skin sends nothing at a limited depth", () => {
  const { mouse, poses, said, draw } = scene();
  draw([200, 200], [202, 200]);
  assert.deepEqual([poses.length, said], [0, []]);
  mouse.depth_m = 0.03;
  draw([10, 10], [10, 390]);
  assert.deepEqual([poses.length, said], [0, ["began", "nothing"]]);
  mouse.depth_m = null;
  draw([10, 10], [10, 390]);
  assert.ok(poses.length > 0);
  assert.equal(said.at(-1), "sent");
});

test("a stroke that begins beside the body comes in where the hand does", () => {
  const { mouse, poses, draw } = scene();
  mouse.depth_m = 0.03;
  draw([10, 200], [200, 200]);
  assert.ok(poses.length > 0);
  const edge = -0.1, // of the skin; the hand moves by 0.02 m at a time
    first = poses[0].tip.x;
  assert.ok(first > edge - 0.04, `begins at ${first}`);
});

test("where one part is in front of another the blade does not jump", () => {
  const { mouse, poses, hand } = scene();
  mouse.depth_m = 0.01;
  const steps = () => poses.slice(1).map((p, i) => Math.abs(p.tip.z - poses[i].tip.z));
  hand("pointerdown", 180, 200);
  hand("pointermove", 190, 200);
  mouse.stage.body.raycast = () => 1 - kSkin_m + 0.1; // what is behind, 0.1 m deeper
  for (let x = 191; x < 230; ++x) hand("pointermove", x, 200);
  hand("pointerup", 230, 200);
  assert.ok(Math.max(...steps()) < 0.06, `${Math.max(...steps())} m at once`);
  assert.ok(poses.at(-1).tip.z < -0.07, "it follows in the end");
});

test("a hand that rests repeats its pose, so that the stroke goes on", (t) => {
  const { mouse, poses, hand } = scene();
  let now = performance.now();
  t.mock.method(performance, "now", () => now);
  hand("pointerdown", 140, 200);
  hand("pointermove", 200, 200);
  const moved = poses.length;
  now += 50;
  mouse.tick();
  assert.equal(poses.length, moved);
  now += 50;
  mouse.tick();
  assert.ok(poses.length > moved);
  assert.equal(poses.at(-1).buttons, 1);
  mouse.cancel();
  const ended = poses.length;
  now += 1000;
  mouse.tick();
  assert.equal(poses.length, ended);
});

test("only the first button begins a stroke", () => {
  const { hand, said, mouse } = scene();
  hand("pointerdown", 100, 200, 8, { button: 2 });
  for (let x = 110; x <= 300; x += 10) hand("pointermove", x, 200, 8, { button: -1 });
  assert.equal(mouse.cutting, false);
  assert.deepEqual(said, []);
});

test("a finger that is not the first begins no stroke", () => {
  const { said, hand } = scene();
  hand("pointerdown", 140, 200, 8, { pointerType: "touch", isPrimary: false });
  hand("pointermove", 200, 200);
  assert.deepEqual(said, []);
});

test("a hand that may not cut is told so, a second finger ends the stroke", () => {
  const { mouse, poses, said, hand, draw } = scene();
  mouse.enabled = false;
  draw([140, 200], [260, 200]);
  assert.deepEqual([poses.length, said], [0, ["refused"]]);
  mouse.enabled = true;
  hand("pointerdown", 140, 200);
  hand("pointermove", 200, 200);
  assert.equal(mouse.cutting, true);
  hand("pointerdown", 240, 240);
  assert.equal(mouse.cutting, false);
  assert.equal(poses.at(-1).buttons, 0);
});

test("latency is that of the last pose behind a picture, measured once", () => {
  const latency = new Latency();
  assert.equal(latency.drawn(), null);
  assert.equal(latency.takeMedian(), undefined);
  for (const posed of [100, 130, 190]) {
    latency.expect(posed);
    latency.drawn()(200);
    assert.equal(latency.drawn(), null); // the next picture shows nothing new
  }
  assert.equal(latency.takeMedian(), 70);
  assert.equal(latency.takeMedian(), undefined);
});

test("a picture without a pose, and one of what was cut while the page was hidden, is not measured", () => {
  const latency = new Latency();
  latency.expect(0);
  assert.equal(latency.drawn(), null);
  latency.seen(5000);
  latency.expect(4000);
  assert.equal(latency.drawn(), null);
  latency.expect(5001);
  latency.drawn()(5011);
  assert.equal(latency.takeMedian(), 10);
});

test("the blade is shown where it would enter, while no button is pressed and it can cut", () => {
  const { mouse, said, hand, poses } = scene();
  const moveTo = (x, y, more) => hand("pointermove", x, y, 8, { buttons: 0, ...more });
  mouse.depth_m = 0.03;
  assert.equal(mouse.preview(), null);
  moveTo(210, 190);
  assert.deepEqual(said, ["hovered"]);
  const { heel, entry, tip } = mouse.preview();
  near(entry.z, kSkin_m, 1e-9);
  near(tip.distanceTo(entry), 0.03, 1e-6);
  near(tip.distanceTo(heel), kLength_m, 1e-6);
  // Right through: the blade's middle is in the body's; a tilted blade enters beside the pointer.
  mouse.depth_m = null;
  mouse.tilt_rad = 0.5;
  const tilted = mouse.preview();
  near(tilted.tip.z + tilted.heel.z, 0, 0.03);
  near(tilted.entry.z, kSkin_m, 1e-6);
  assert.ok(tilted.entry.distanceTo(entry) > 0.005);
  const along = tilted.tip.clone().sub(tilted.heel).normalize();
  near(tilted.entry.clone().sub(tilted.heel).cross(along).length(), 0, 1e-6);
  // Not beside the body, for a finger, a turning hand, a pointer that has left, or where nothing can be cut.
  for (const [x, y, more] of [
    [1, 1, {}],
    [210, 190, { pointerType: "touch" }],
    [210, 190, { buttons: 2 }],
  ]) {
    moveTo(x, y, more);
    assert.equal(mouse.preview(), null);
  }
  moveTo(210, 190);
  mouse.enabled = false;
  assert.equal(mouse.preview(), null);
  mouse.enabled = true;
  hand("pointerleave", 0, 0);
  assert.equal(mouse.preview(), null);
  moveTo(210, 190);
  hand("pointerdown", 210, 190);
  assert.equal(mouse.preview(), null);
  assert.equal(poses.length, 0);
});
