// How the page turns the state into a picture: corners, sides of cuts, how they open, sections, the skin under the mouse.

import assert from "node:assert/strict";
import { test } from "node:test";
import { fill, load } from "./modules.mjs";

const {
  Surface,
  CornerBuilder,
  allocateCorners,
  SkinDepth,
  computeOpening,
  measureFaces,
  sidesOf,
  kUnknown,
  kWall,
  kParted,
  planeOf,
  axisFacing,
  mirrored,
  across,
  axisOf,
  through,
  otherHalf,
  crossings,
  BodyMesh,
  rangesOf,
  BladeView,
  ForceArrows,
  Chart,
  Flight,
  pick,
  follow,
  placeOn,
  sideArea,
  Ray,
  toFragment,
  fromFragment,
  Vector3,
} = await load(
  "surface",
  "corner_buffers",
  "skin_depth",
  "opening",
  "cut_sides",
  "section",
  "section_lines",
  "body_mesh",
  "blade_view",
  "force_arrows",
  "chart",
  "views",
  "pick",
  "view_link",
  "../node_modules/three",
);

const near = (a, b, tolerance = 1e-6) => assert.ok(Math.abs(a - b) <= tolerance, `${a}, wanted ${b}`);

/** The outside of a box from (0, 0, 0) to (nx, ny, nz), a grid of unit squares of two triangles each, with a slit in the plane
 * y = `at` from the top down to z = `bottom`, between x = 0 and x = nx: the walls have vertices of their own but at the bottom. */
function slitBox({ nx = 6, ny = 6, nz = 4, at = 3, bottom = 2 } = {}) {
  const vertices = [],
    triangles = [],
    ids = new Map();
  const vertex = (x, y, z, side = 0) => {
    const key = [x, y, z, y === at && z > bottom ? side : 0].join();
    if (!ids.has(key)) ids.set(key, vertices.push([x, y, z]) - 1);
    return ids.get(key);
  };
  /** side: -1 where the square belongs to what lies below y = at, 1 above. */
  const quad = (corners, side, cut = false) => {
    const [a, b, c, d] = corners.map((p) => vertex(...p, side));
    triangles.push({ v: [a, b, c], cut }, { v: [a, c, d], cut });
  };
  for (let x = 0; x < nx; ++x) {
    for (let y = 0; y < ny; ++y) {
      const side = y < at ? -1 : 1;
      quad(
        [
          [x, y, nz],
          [x + 1, y, nz],
          [x + 1, y + 1, nz],
          [x, y + 1, nz],
        ],
        side,
      );
      quad(
        [
          [x, y, 0],
          [x, y + 1, 0],
          [x + 1, y + 1, 0],
          [x + 1, y, 0],
        ],
        side,
      );
    }
    for (let z = 0; z < nz; ++z) {
      quad(
        [
          [x, 0, z],
          [x + 1, 0, z],
          [x + 1, 0, z + 1],
          [x, 0, z + 1],
        ],
        -1,
      );
      quad(
        [
          [x, ny, z],
          [x, ny, z + 1],
          [x + 1, ny, z + 1],
          [x + 1, ny, z],
        ],
        1,
      );
      if (z < bottom) continue;
      quad(
        [
          [x, at, z],
          [x, at, z + 1],
          [x + 1, at, z + 1],
          [x + 1, at, z],
        ],
        -1,
        true,
      ); // its outside is +y
      quad(
        [
          [x, at, z],
          [x + 1, at, z],
          [x + 1, at, z + 1],
          [x, at, z + 1],
        ],
        1,
        true,
      );
    }
  }
  for (let y = 0; y < ny; ++y) {
    for (let z = 0; z < nz; ++z) {
      const side = y < at ? -1 : 1;
      quad(
        [
          [0, y, z],
          [0, y, z + 1],
          [0, y + 1, z + 1],
          [0, y + 1, z],
        ],
        side,
      );
      // A cut made this face: it went through, and what was beyond is another piece.
      quad(
        [
          [nx, y, z],
          [nx, y + 1, z],
          [nx, y + 1, z + 1],
          [nx, y, z + 1],
        ],
        side,
        true,
      );
    }
  }
  return { vertices, triangles };
}

/** The slit box, and next to it at x = nx the piece that a through-cut has parted from it: a slab one unit thick. */
function crossedBox() {
  const box = slitBox();
  const { vertices, triangles } = box;
  const first = vertices.length;
  for (const y of [0, 1, 2, 3, 4, 5, 6]) for (const z of [0, 1, 2, 3, 4]) vertices.push([6, y, z]);
  const id = (y, z) => first + 5 * y + z;
  for (let y = 0; y < 6; ++y) {
    for (let z = 0; z < 4; ++z) {
      const [a, b, c, d] = [id(y, z), id(y, z + 1), id(y + 1, z + 1), id(y + 1, z)];
      triangles.push({ v: [a, c, b], cut: true, piece: 1 }, { v: [a, d, c], cut: true, piece: 1 });
    }
  }
  // They divide their squares as the other side does, and look towards -x.
  for (let i = triangles.length - 48; i < triangles.length; i += 2) {
    const [a, c, b] = triangles[i].v,
      d = triangles[i + 1].v[1];
    triangles[i].v = [a, b, c];
    triangles[i + 1].v = [a, c, d];
  }
  return box;
}

const filled = ({ vertices, triangles }) => fill(new Surface(), vertices, triangles);

test("faces of a slit are walls, those beside another piece are parted", () => {
  const surface = filled(crossedBox());
  const faces = measureFaces(surface);
  const sides = sidesOf(surface, faces);
  const count = [0, 0, 0];
  for (const slot of faces.cut) ++count[sides[slot]];
  assert.equal(count[kWall], 48); // 6 x 2 squares of two triangles on either side
  assert.equal(count[kParted], 96);
  assert.equal(count[kUnknown], 0);
  near(faces.cutArea, 2 * 12 + 2 * 24);
});

test("a face without another side is what its neighbours in the same wall are", () => {
  const box = crossedBox();
  // One wall alone is divided further: a triangle's middle gets a vertex.
  const wall = box.triangles.findIndex(
    (t) => t.cut && t.v.every((v) => box.vertices[v][1] === 3) && box.vertices[t.v[0]][0] === 2,
  );
  const [a, b, c] = box.triangles[wall].v;
  const m =
    box.vertices.push([0, 1, 2].map((k) => (box.vertices[a][k] + box.vertices[b][k] + box.vertices[c][k]) / 3)) - 1;
  box.triangles.splice(wall, 1, { v: [a, b, m], cut: true }, { v: [b, c, m], cut: true }, { v: [c, a, m], cut: true });
  const surface = filled(box);
  const faces = measureFaces(surface);
  const sides = sidesOf(surface, faces);
  assert.ok(faces.cut.every((slot) => sides[slot] !== kUnknown));
});

test("in a deformed body, where the gap stands open, the shape of its walls tells them from a parted face", () => {
  const box = crossedBox();
  for (const triangle of box.triangles)
    triangle.low = normalY(box, triangle) > 0 || triangle.v.some((v) => box.vertices[v][1] < 3);
  const low = new Set(box.triangles.filter((t) => t.low).flatMap((t) => t.v));
  box.vertices.forEach((p, v) => {
    if (p[1] === 3 && p[2] > 2) p[1] += (low.has(v) ? -0.4 : 0.4) * (p[2] - 2);
    if (v >= box.vertices.length - 35) p[0] += 3; // the other piece has moved away
  });
  const surface = filled(box);
  const faces = measureFaces(surface);
  const sides = sidesOf(surface, faces);
  const count = [0, 0, 0];
  for (const slot of faces.cut) ++count[sides[slot]];
  assert.deepEqual(count, [0, 48, 96]);
});

test("a small slit is a wall where its sides lie together, and a flap where they stand apart", () => {
  const box = slitBox({ nx: 2, bottom: 3 }); // two squares of two triangles on either side
  const inSlit = (slot) => box.triangles[slot].v.every((v) => box.vertices[v][1] === 3);
  const sidesIn = (surface) => {
    const faces = measureFaces(surface);
    const sides = sidesOf(surface, faces);
    return faces.cut.filter(inSlit).map((slot) => sides[slot]);
  };
  assert.deepEqual(sidesIn(filled(box)), Array(8).fill(kWall));
  const open = filled({
    ...box,
    vertices: box.vertices.map(([x, y, z], v) => {
      const wall = box.triangles.find((t) => t.cut && t.v.includes(v) && y === 3);
      return wall && z > 3 ? [x, y - Math.sign(normalY(box, wall)), z] : [x, y, z];
    }),
  });
  assert.deepEqual(sidesIn(open), Array(8).fill(kParted));
});

function normalY({ vertices }, { v: [a, b, c] }) {
  const [ux, , uz] = vertices[b].map((x, k) => x - vertices[a][k]);
  const [vx, , vz] = vertices[c].map((x, k) => x - vertices[a][k]);
  return uz * vx - ux * vz;
}

function opened(box) {
  const surface = filled(box);
  const out = { lips: new Float32Array(0), pieces: new Float32Array(0), cutArea_m2: 0 };
  computeOpening(surface, (piece) => piece, 2, 9, out);
  const at = (test) =>
    [...box.vertices.keys()]
      .filter((v) => test(...box.vertices[v]))
      .map((v) => [...out.lips.subarray(3 * v, 3 * v + 3)]);
  return { out, at, surface };
}

test("a slit's lips go apart, its front stays, and a parted face stays plane", () => {
  const box = crossedBox();
  const { out, at } = opened(box);
  near(out.cutArea_m2, 36);
  const top = at((x, y, z) => y === 3 && z === 4 && x === 3)
    .map((d) => d[1])
    .sort((a, b) => a - b);
  assert.equal(top.length, 2);
  assert.ok(top[0] < -0.1 && top[1] > 0.1, `${top}`);
  near(top[0], -top[1], 0.05);
  // Each away from the other: the side at smaller y moves to smaller y.
  const lower = box.triangles.find(
    (t) =>
      t.cut &&
      t.v.every((v) => box.vertices[v][1] === 3) &&
      normalY(box, t) > 0 &&
      t.v.some((v) => box.vertices[v][2] === 4),
  );
  const lip = lower.v.find((v) => box.vertices[v][2] === 4);
  assert.ok(out.lips[3 * lip + 1] < 0);
  for (const d of at((x, y, z) => y === 3 && z === 2 && x > 0 && x < 6))
    assert.ok(Math.hypot(...d) < 0.01, `the front moves by ${d}`);
  for (const d of at((x) => x === 6)) assert.ok(Math.abs(d[0]) < 0.05 * top[1], `a parted face moves by ${d}`);
});

test("pieces go away from each other, an uncut body stays", () => {
  const { out } = opened(crossedBox());
  assert.ok(out.pieces[4] > out.pieces[0]); // the slab is at larger x
  const whole = slitBox();
  for (const triangle of whole.triangles) triangle.cut = false;
  const surface = filled(whole);
  computeOpening(surface, () => 0, 1, 9, out);
  assert.deepEqual([...out.pieces.subarray(0, 4)], [0, 0, 0, 0]);
  assert.equal(out.cutArea_m2, 0);
  assert.ok(out.lips.every((x) => x === 0));
  // Nor does one that is cut, as long as it is one piece.
  computeOpening(filled(slitBox()), () => 0, 1, 9, out);
  assert.deepEqual([...out.pieces.subarray(0, 4)], [0, 0, 0, 0]);
});

test("normals are smooth over the skin and break at an edge", () => {
  const tent = (height) => {
    const surface = fill(
      new Surface(),
      [
        [0, 0, 0],
        [1, 0, height],
        [1, 1, height],
        [0, 1, 0],
        [2, 0, 0],
        [2, 1, 0],
      ],
      [{ v: [0, 1, 2] }, { v: [0, 2, 3] }, { v: [1, 4, 5] }, { v: [1, 5, 2] }],
    );
    const builder = new CornerBuilder(surface);
    builder.restart();
    builder.measureAll();
    const out = allocateCorners(1);
    builder.write(0, out, 0);
    return [...out.normals.subarray(4, 7)].map((n) => n / 32767); // of the ridge's corner
  };
  near(tent(0.1)[0], 0, 0.05); // both sides' normals are one there
  near(tent(1)[0], -Math.SQRT1_2, 0.001); // a sharp ridge keeps each side's own
});

test("quality without tetrahedra is that of the triangle; rows are given to pieces as they come", () => {
  const surface = fill(
    new Surface(),
    [
      [0, 0, 0],
      [1, 0, 0],
      [0.5, Math.sqrt(0.75), 0],
      [0.5, 0.01, 0],
    ],
    [
      { v: [0, 1, 2], piece: 9 },
      { v: [0, 1, 3], piece: 4, cut: true },
    ],
  );
  const builder = new CornerBuilder(surface);
  builder.restart();
  builder.measureAll();
  const out = allocateCorners(2);
  builder.write(0, out, 0);
  builder.write(1, out, 1);
  assert.deepEqual([...out.facts.subarray(0, 4)], [0, 255, 1, 0]);
  assert.equal(out.facts[12], 255); // a cut face, deep inside as far as is known
  assert.ok(out.facts[13] < 20);
  assert.deepEqual([builder.rowOf(0), builder.rowOf(9), builder.rowOf(4), builder.rowCount], [0, 1, 2, 3]);
  for (let piece = 1000; builder.rowCount < 300; ++piece) builder.rowOf(piece);
  surface.pieces[0] = 5000;
  builder.write(0, out, 0);
  assert.deepEqual([...out.facts.subarray(2, 4)], [300 & 255, 1]); // low byte, high byte
  surface.clearTouched();
  surface.removeTriangles(Uint32Array.of(0));
  assert.ok([...builder.touched()].includes(0));
  builder.write(0, out, 0);
  assert.ok(out.positions.subarray(0, 9).every((x) => x === 0)); // a free slot has no size
});

test("slots to draw again ascend, in whatever order they changed", () => {
  const surface = fill(
    new Surface(),
    [
      [0, 0, 0],
      [1, 0, 0],
      [0, 1, 0],
      [5, 0, 0],
      [6, 0, 0],
      [5, 1, 0],
    ],
    [{ v: [0, 1, 2] }, { v: [3, 4, 5] }, { v: [0, 2, 1] }],
  );
  const builder = new CornerBuilder(surface);
  builder.measureAll();
  surface.clearTouched();
  surface.touchedSlots.add(2).add(1);
  assert.deepEqual([...builder.touched()], [0, 1, 2]);
});

test("skin and cut faces that continue each other have an edge between them", () => {
  const surface = fill(
    new Surface(),
    [
      [0, 0, 0],
      [1, 0, 0.1],
      [1, 1, 0.1],
      [2, 0, 0],
      [2, 1, 0],
    ],
    [{ v: [0, 1, 2] }, { v: [1, 3, 4], cut: true }, { v: [1, 4, 2], cut: true }],
  );
  const builder = new CornerBuilder(surface);
  builder.restart();
  builder.measureAll();
  const out = allocateCorners(1);
  builder.write(0, out, 0);
  const own = -0.1 / Math.hypot(0.1, 1); // of the skin's triangle alone
  for (const corner of [0, 1, 2]) near(out.normals[4 * corner] / 32767, own, 0.001);
});

test("a section's plane keeps what is below it, on the side that is asked for", () => {
  const min = [0, 0, 0],
    max = [1, 2, 4];
  assert.deepEqual(planeOf({ normal: [0, 0, 1], share: 0.5 }, min, max), [0, 0, 1, 2]);
  assert.deepEqual(planeOf({ normal: [0, -1, 0], share: 0.5 }, min, max), [0, -1, 0, -1]);
  const [, , , low] = planeOf({ normal: [1, 0, 0], share: 0 }, min, max),
    [, , , high] = planeOf({ normal: [1, 0, 0], share: 1 }, min, max);
  assert.ok(low < 0 && high > 1);
  assert.equal(axisFacing([-0.2, -0.9, 0.4]), 1);
  assert.deepEqual(across(1, [-0.2, -0.9, 0.4]), [0, -1, 0]);
  assert.deepEqual(across(2, [-0.2, -0.9, 0.4]), [0, 0, 1]);
  assert.deepEqual([axisOf([0, -1, 0]), axisOf([0, 0.6, 0.8])], [1, -1]);
});

test("a section through a point has it on its plane in any direction, as far as there is body", () => {
  const min = [-1, -2, 0],
    max = [1, 3, 4];
  for (const normal of [
    [0, 0, 1],
    [0, -1, 0],
    [0.6, 0, -0.8],
    [2 / 3, -2 / 3, 1 / 3],
  ]) {
    const point = [0.3, 1.5, 2.25];
    const [x, y, z, offset] = planeOf(through(point, normal, min, max), min, max);
    near(x * point[0] + y * point[1] + z * point[2], offset);
    assert.deepEqual([x, y, z], normal);
    const other = planeOf(otherHalf(through(point, normal, min, max)), min, max);
    for (const [k, n] of [-x, -y, -z, -offset].entries()) near(other[k], n);
    assert.equal(
      through(
        [100, 100, 100].map((far, k) => far * Math.sign(normal[k])),
        normal,
        min,
        max,
      ).share,
      1,
    );
  }
});

test("the other half of a section is seen from the mirrored place, so it faces the eye, too", () => {
  const toEye = [0.3, -0.5, 0.8];
  for (const normal of [
    [1, 0, 0],
    [0, -1, 0],
    [0.6, 0, 0.8],
  ]) {
    const along = (v) => v.reduce((sum, x, k) => sum + x * normal[k], 0);
    const there = mirrored(toEye, normal);
    near(along(there), -along(toEye));
    for (const [k, x] of mirrored(there, normal).entries()) near(x, toEye[k]);
  }
});

test("a plane crosses triangles along segments, and knows which are of a cut", () => {
  const corners = [
    [0, 0, 0, 1, 0, 0, 0, 0, 2],
    [0, 0, 5, 1, 0, 5, 0, 0, 6],
    [0, 0, 0, 1, 0, 0, 0, 0, 2],
    [0, 0, 0, 1, 0, 0, 0, 0, 2],
  ];
  const triangles = {
    slots: 4,
    corners: (slot, out) => {
      out.set(corners[slot]);
      return slot !== 3;
    },
    isCut: (slot) => slot === 2,
  };
  const seen = [];
  crossings(triangles, [0, 0, 1, 0.5], (segment, cut) => seen.push({ ends: [...segment], cut }));
  assert.deepEqual(seen, [
    { ends: [0.75, 0, 0.5, 0, 0, 0.5], cut: false },
    { ends: [0.75, 0, 0.5, 0, 0, 0.5], cut: true },
  ]);
});

test("uploads cover every slot in few ranges", () => {
  const slots = Uint32Array.from({ length: 400 }, (_, i) => i * i);
  const ranges = rangesOf(slots);
  assert.ok(ranges.length <= 24);
  for (const slot of slots)
    assert.ok(
      ranges.some(([begin, end]) => slot >= begin && slot < end),
      `slot ${slot}`,
    );
  assert.deepEqual(rangesOf(Uint32Array.of(3, 4, 5)), [[3, 6]]);
});

test("with a section, a ray meets the inside that it shows and nothing that it hides", () => {
  const body = new BodyMesh();
  const corners = allocateCorners(2); // a slab from z = 0 to 1
  corners.positions.set([-1, -1, 1, 3, -1, 1, -1, 3, 1, -1, 3, 0, 3, -1, 0, -1, -1, 0]);
  body.replace(2, 4, corners);
  const met = (plane, z, dz, x = 0) => {
    body.setSection(plane);
    return body.raycast(new Vector3(x, 0, z), new Vector3(0, 0, dz));
  };
  near(met(null, 5, -1), 4);
  near(met([0, 0, 1, 2], 5, -1), 4); // before the body
  near(met([0, 0, 1, 0.4], 5, -1), 4.6);
  near(met([0, 0, 1, 0.4], -5, 1), 5); // from the other side
  near(met([0, 0, -1, -0.4], 5, -1), 4);
  for (const [plane, ...ray] of [
    [[0, 0, 1, -0.1], 5, -1], // behind the body
    [[0, 0, 1, 0.4], 5, -1, 9], // beside it
    [[0, 0, 1, 0.4], 5, 1],
    [[0, 0, -1, -1.1], 5, -1],
    [[1, 0, 0, -0.5], 5, -1], // along the plane, in what it hides
  ])
    assert.ok(Number.isNaN(met(plane, ...ray)), JSON.stringify([plane, ray]));
  near(met([1, 0, 0, 0.5], 5, -1), 4);
  near(met(null, 5, -1), 4);
});

test("a ray meets the nearest skin that faces it, and passes cut faces", () => {
  const body = new BodyMesh();
  const layer = (z, cut, flipped = false) => ({ z, cut, flipped });
  const layers = [layer(0, false), layer(1, false), layer(2, true), layer(3, false, true)];
  const corners = allocateCorners(layers.length);
  layers.forEach(({ z, cut, flipped }, i) => {
    const square = [
      [-1, -1, z],
      [3, -1, z],
      [-1, 3, z],
    ];
    corners.positions.set((flipped ? square.reverse() : square).flat(), 9 * i);
    for (let k = 0; k < 3; ++k) corners.facts[12 * i + 4 * k] = Number(cut);
  });
  body.replace(layers.length, 8, corners);
  near(body.raycast(new Vector3(0, 0, 5), new Vector3(0, 0, -1)), 4);
  assert.ok(Number.isNaN(body.raycast(new Vector3(9, 0, 5), new Vector3(0, 0, -1))));
  // A patch replaces slots in place.
  const one = allocateCorners(1);
  one.positions.set([-1, -1, 1.5, 3, -1, 1.5, -1, 3, 1.5]);
  body.patch(Uint32Array.of(0), 4, one);
  near(body.raycast(new Vector3(0, 0, 5), new Vector3(0, 0, -1)), 3.5);
  const before = body.version;
  const lips = new Float32Array(36).fill(0);
  lips[2] = 0.25;
  body.setOpening(lips, new Float32Array([0, 0, 1, 0]));
  assert.ok(body.version > before);
  const out = new Float64Array(9);
  assert.equal(body.shown(0.5).corners(0, out), true);
  near(out[2], 1.5 + 0.5 * (0.25 + 1));
  near(out[5], 1.5 + 0.5 * 1);
});

test("a patch beyond the last slot is drawn, and only its slots are uploaded", () => {
  const body = new BodyMesh();
  body.replace(2, 40, allocateCorners(2));
  const one = allocateCorners(1);
  one.positions.fill(1);
  body.patch(Uint32Array.of(30), 31, one);
  assert.equal(body.slots, 31);
  assert.equal(body.drawnTriangles().length, 9);
  const { geometry } = body.mesh;
  assert.equal(geometry.drawRange.count, 3 * 31);
  for (const [name, size] of [
    ["position", 9],
    ["aNormal", 12],
    ["aFacts", 12],
  ])
    assert.deepEqual(geometry.getAttribute(name).updateRanges, [{ start: 30 * size, count: size }], name);
  body.patch(Uint32Array.of(0), 1, one);
  assert.equal(body.slots, 31); // the rest is still there
});

test("more pieces than a row of the texture holds get a larger one, and each is moved by its own entry", () => {
  const body = new BodyMesh();
  const corners = allocateCorners(1);
  corners.positions.fill(1);
  corners.facts.set([0, 0, 300 & 255, 300 >> 8]);
  body.replace(1, 8, corners);
  const before = body.uniforms.uPieces.value;
  const pieces = new Float32Array(4 * 301);
  pieces.set([2, 3, 4, 0], 4 * 300);
  body.setOpening(new Float32Array(9), pieces);
  const texture = body.uniforms.uPieces.value;
  assert.notEqual(texture, before);
  assert.deepEqual([texture.image.width, texture.image.height], [256, 2]);
  assert.deepEqual([...texture.image.data.subarray(4 * 300, 4 * 300 + 4)], [2, 3, 4, 0]);
  const out = new Float64Array(9);
  body.shown(1).corners(0, out);
  assert.deepEqual([...out.subarray(0, 3)], [3, 4, 5]);
});

test("the trail of a long stroke does not join its end to its beginning", (t) => {
  t.mock.method(performance, "now", () => 5000); // nothing of the trail has faded
  const blade = new BladeView(1, false);
  for (let i = 0; i < 300; ++i) blade.move([i, 0, 0], [i, 0, -1], true);
  blade.update(new Vector3(0, 0, 5));
  const { geometry } = blade.trail;
  assert.equal(geometry.drawRange.count, 6 * 255); // between the 256 samples that are kept
  const { array } = geometry.getAttribute("position");
  for (let i = 0; i < 6 * 255; i += 6) {
    const xs = [0, 1, 2, 3, 4, 5].map((k) => array[3 * (i + k)]);
    assert.equal(Math.max(...xs) - Math.min(...xs), 1);
  }
});

test("the trails of two strokes are not joined", (t) => {
  t.mock.method(performance, "now", () => 5000);
  const blade = new BladeView(1, false);
  for (const from of [0, 100]) {
    for (let i = from; i < from + 3; ++i) blade.move([i, 0, 0], [i, 0, -1], true);
    blade.endStroke();
  }
  blade.update(new Vector3(0, 0, 5));
  const { geometry } = blade.trail;
  const { array } = geometry.getAttribute("position");
  const xs = Array.from({ length: geometry.drawRange.count }, (_, i) => array[3 * i]);
  assert.deepEqual(
    [...new Set(xs)].sort((a, b) => a - b),
    [0, 1, 2, 100, 101, 102],
  );
  for (let i = 0; i < xs.length; i += 6) {
    const six = xs.slice(i, i + 6);
    assert.equal(Math.max(...six) - Math.min(...six), 1);
  }
});

test("a chart shows the last half minute, the newest value at its right", () => {
  const points = [];
  const context = new Proxy(
    { lineTo: (x, y) => points.push([x, y]), beginPath: () => (points.length = 0) },
    { get: (target, name) => target[name] ?? (() => {}), set: () => true },
  );
  globalThis.devicePixelRatio = 1;
  globalThis.getComputedStyle = () => ({ getPropertyValue: () => "" });
  const chart = new Chart({ dataset: {}, clientWidth: 100, clientHeight: 40, getContext: () => context }, 10, 1);
  for (let i = 0; i < 45; ++i) chart.push(i < 44 ? 0 : 20);
  assert.equal(points.length, 30 + 2); // two more close the area below the line
  const [x, y] = points[29];
  assert.equal(x, 100);
  assert.ok(y < 10, "the highest value is near the top");
  assert.ok(points.slice(0, 29).every(([, other]) => other > 30));
});

test("the camera flies around the body, the shorter way, and arrives where it should", () => {
  const place = (position) => ({ position: new Vector3(...position), target: new Vector3(1, 0, 0) });
  const to = place([1, 2, 0]);
  const flight = new Flight(place([1, -2, 0]), to, 1000);
  const now = place([0, 0, 0]);
  for (const ms of [1000, 1100, 1190, 1300]) {
    assert.equal(flight.move(ms, now), false);
    near(now.position.distanceTo(now.target), 2);
  }
  assert.equal(flight.move(1380, now), true);
  near(now.position.distanceTo(to.position), 0);
  // Over the place where the angle jumps it is 20 degrees, not 340.
  const at = (degrees) => {
    const a = (degrees * Math.PI) / 180;
    return place([1 + Math.cos(a), Math.sin(a), 0]);
  };
  new Flight(at(80), at(100), 0).move(190, now);
  near(now.position.y, 1);
});

test("a link gives back the view that it was made of, and nothing for what makes no sense", () => {
  const view = {
    camera: { body: "liver & more.vtu", position: [0.25, -1.5, 1e-5], target: [0, 0.125, 0] },
    section: { normal: [0.6, 0, -0.8], share: 0.305 },
    colours: "quality",
    theme: "light",
  };
  assert.deepEqual(fromFragment(`#${toFragment(view)}`), view);
  assert.deepEqual(fromFragment(""), {});
  for (const bad of [
    "#from=1,2,3",
    "#from=1,2,3&to=1,2,3", // it looks nowhere
    "#from=1,2,3&to=1,2",
    "#from=1,2,Infinity&to=0,0,0",
    "#from=1,2,&to=0,0,0",
    "#from=1e9,0,0&to=0,0,0",
    "#section=w,1,0,0.5",
    "#section=2,0,0,0.5",
    "#section=0,0,0,0.5",
    "#section=0,0,1,1.5",
    "#section=0,1,0.5",
    "#section=1,0,0,0.5,0",
    "#colours=toString&theme=blue",
    "#%E0%A4%A&&==",
    `#theme=light&${"x".repeat(5000)}`,
  ])
    assert.deepEqual(fromFragment(bad), {}, bad);
});

test("one side of a cut is measured, not the other, nor the skin", () => {
  const surface = filled(slitBox());
  const faces = measureFaces(surface);
  near(sideArea(surface, faces, faces.cut[0]), 12); // a wall of the slit
  near(sideArea(surface, faces, faces.cut.at(-1)), 24); // the end that another cut left, where the slit meets it
  near(faces.cutArea, 48);
});

test("a place is picked on what is drawn, stays on its triangle, and is lost with it", () => {
  const body = new BodyMesh();
  const corners = allocateCorners(3);
  const triangle = (z, flip) => (flip ? [0, 0, z, 0, 4, z, 4, 0, z] : [0, 0, z, 4, 0, z, 0, 4, z]);
  corners.positions.set([...triangle(1, false), ...triangle(2, false), ...triangle(0, true)]);
  corners.ids.set([40, 41, 42]);
  for (let k = 0; k < 3; ++k) corners.facts[12 + 4 * k] = 1; // the upper one is a cut face
  body.replace(3, 8, corners);
  const down = new Ray(new Vector3(1, 2, 9), new Vector3(0, 0, -1));
  const hit = pick(body, 0, null, down);
  assert.deepEqual([hit.halfFace, hit.slot, hit.isCut, hit.distance], [41, 1, true, 7]);
  assert.deepEqual(hit.weights, [0.25, 0.25, 0.5]);
  // A section takes the upper one away, and then both: what one sees then is the inside.
  assert.equal(pick(body, 0, [0, 0, 1, 1.5], down).halfFace, 40);
  assert.equal(pick(body, 0, [0, 0, 1, 0.5], down), null);
  assert.equal(pick(body, 0, null, new Ray(new Vector3(9, 9, 9), new Vector3(0, 0, -1))), null);
  // Opened, the surface is elsewhere; the place is so, too.
  body.setOpening(new Float32Array(27), Float32Array.from([0, 0, 10, 0]));
  assert.equal(pick(body, 0.1, null, down).distance, 6);
  assert.deepEqual(placeOn(body, hit, 0.1).toArray(), [1, 2, 3]);
  assert.deepEqual(placeOn(body, hit, 0).toArray(), [1, 2, 2]);
  // Its corner moves; then the whole surface comes again in other slots; then the triangle goes.
  const moved = allocateCorners(1);
  moved.positions.set([0, 0, 2, 4, 0, 2, 0, 4, 4]);
  moved.ids[0] = 41;
  body.patch(Uint32Array.of(1), 3, moved);
  assert.equal(follow(body, hit), true);
  assert.deepEqual(placeOn(body, hit, 0).toArray(), [1, 2, 3]);
  corners.ids.set([42, 40, 41]);
  body.replace(3, 8, corners);
  assert.equal(follow(body, hit), true);
  assert.equal(hit.slot, 2);
  moved.ids[0] = 43;
  body.patch(Uint32Array.of(2), 3, moved);
  assert.equal(follow(body, hit), false);
});

test("depth below the skin is the distance to its triangles, and stays with the tissue when the body deforms", () => {
  // The unit cube's top and bottom, and a cut face that hangs from the top.
  const square = [
    [0, 0, 0],
    [1, 0, 0],
    [1, 1, 0],
    [0, 1, 0],
  ];
  const top = square.map(([x, y]) => [x, y, 1]);
  const inside = [
    [0.5, 0.5, 1],
    [0.5, 0.6, 0.9],
    [0.5, 0.4, 0.5],
  ];
  const surface = fill(
    new Surface(),
    [...square, ...top, ...inside],
    [{ v: [0, 2, 1] }, { v: [0, 3, 2] }, { v: [4, 5, 6] }, { v: [4, 6, 7] }, { v: [8, 9, 10], cut: true }],
  );
  const skin = new SkinDepth(surface, 0.2);
  near(skin.at(0.3, 0.4, 0.95), 0.05, 1e-6);
  near(skin.at(0.3, 0.4, 0.1), 0.1, 1e-6);
  near(skin.at(0.3, 0.4, 0.5), 0.2, 1e-6); // no deeper than it looks
  near(skin.at(1.05, 1.05, 1.05), Math.sqrt(3) * 0.05, 1e-6); // to a corner
  near(skin.at(0.5, 1.1, 1), 0.1, 1e-6); // to an edge
  const builder = new CornerBuilder(surface);
  builder.restart();
  builder.measureAll();
  builder.skin = skin;
  const out = allocateCorners(1);
  const depths = () => {
    builder.write(4, out, 0);
    return [0, 1, 2].map((k) => out.facts[4 * k]);
  };
  assert.deepEqual(depths(), [1, 128, 255]);
  // As a simulation moves it.
  const ids = Uint32Array.of(8, 9, 10);
  surface.setVertices({ idsArray: () => ids, positionsArray: () => Float32Array.from(inside.flat(), (x) => x + 3) });
  surface.setRest({ idsArray: () => ids, positionsArray: () => Float32Array.from(inside.flat()) });
  assert.ok(surface.deformed);
  assert.deepEqual(depths(), [1, 128, 255]);
  const moved = allocateCorners(1, false, true);
  builder.write(4, moved, 0);
  assert.deepEqual([...moved.rest], [...Float32Array.from(inside.flat())]);
  builder.write(0, out, 0);
  assert.equal(out.facts[0], 0);
});

test("a force is an arrow with its newtons, until there is no news of it", () => {
  const drawn = [];
  let now = 0;
  const marks = {
    layers: [],
    draw() {
      drawn.length = 0;
      for (const layer of this.layers) layer(this);
    },
    arrow: (from, to) => drawn.push(from.toArray(), to.toArray()),
    label: (_at, text) => drawn.push(text),
  };
  const arrows = new ForceArrows(
    marks,
    () => 0.2,
    () => now,
  );
  const force = (newtons) => arrows.take({ source: 1, at: [0, 0, 0.1], newtons });
  force([0, 2, 0]);
  marks.draw();
  assert.deepEqual(drawn[0], [0, 0, 0.1]);
  near(drawn[1][1], 2 * 0.04 * 0.2);
  assert.equal(drawn[2], "2.00 N");
  force([0, 0, 100]);
  marks.draw();
  near(drawn[1][2], 0.1 + 0.3 * 0.2); // no longer than that
  assert.equal(drawn[2], "100.0 N");
  now = 300;
  marks.draw();
  assert.equal(drawn.length, 0);
  force([0, 0, 0]);
  marks.draw();
  assert.equal(drawn.length, 0);
  clearTimeout(arrows.alarm);
});
