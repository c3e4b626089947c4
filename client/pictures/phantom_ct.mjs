// A CT of the liver phantom that nobody took: parenchyma with noise, vessels that branch, three lesions. For the pictures.

import { writeFileSync } from "node:fs";
import { gzipSync } from "node:zlib";

const kSize = [176, 130, 110];
const kSpacing_mm = 2;
const kMiddle_mm = [0, 0, 0];
const kTurn = 0.18; // of the scanner's table against the body's axes
// Centres, radii, Hounsfield units; a rim around each takes up contrast.
const kLesions = [
  [[-72, 22, 8], 16, 25],
  [[-38, -28, -6], 8, 28],
  [[62, 4, 8], 10, 30],
];

/** Numbers from 0 to 1, the same in each run (Lehmer 1951). */
function generator(seed) {
  let state = seed;
  return () => (state = (state * 48271) % 2147483647) / 2147483647;
}

/** Segments [from, to, radius], mm. */
function vessels(random) {
  const out = [];
  const around = () => random() + random() - 1;
  const grow = (from, direction, radius, generation) => {
    if (generation > 8 || radius < 0.9) return;
    const to = from.map((x, i) => x + direction[i] * 24 * 0.87 ** generation);
    out.push([from, to, radius]);
    for (let child = 0; child < 2; ++child) {
      const bent = direction.map((x) => x + 0.8 * around());
      const length = Math.hypot(...bent);
      grow(
        to,
        bent.map((x) => x / length),
        0.79 * radius,
        generation + 1,
      );
    }
  };
  grow([-15, 15, -25], [-0.7, 0.1, 0.6], 7, 0);
  grow([-15, 15, -25], [0.8, -0.2, 0.4], 7, 0);
  grow([-50, 50, 20], [-0.3, -0.9, 0.1], 5.5, 1);
  grow([10, 45, 10], [0.5, -0.8, 0.1], 5, 1);
  return out;
}

function distance(p, [from, to, radius]) {
  const d = to.map((x, i) => x - from[i]),
    w = p.map((x, i) => x - from[i]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const t = Math.min(1, Math.max(0, dot(d, w) / dot(d, d)));
  return Math.hypot(...w.map((x, i) => x - t * d[i])) - radius;
}

/** Writes it as NRRD: LPS, millimetres, 16 bits, gzip. */
export function writePhantomCt(path) {
  const random = generator(11);
  const [c, s] = [kSpacing_mm * Math.cos(kTurn), kSpacing_mm * Math.sin(kTurn)];
  const axes = [
    [c, s, 0],
    [-s, c, 0],
    [0, 0, kSpacing_mm],
  ];
  const origin = kMiddle_mm.map((m, r) => m - axes.reduce((sum, axis, a) => sum + (axis[r] * (kSize[a] - 1)) / 2, 0));
  const place = (i, j, k) => origin.map((o, r) => o + axes[0][r] * i + axes[1][r] * j + axes[2][r] * k);
  const voxels = new Int16Array(kSize[0] * kSize[1] * kSize[2]).fill(95);
  /** Calls back for the voxels within `reach` of a place, with the place of each. */
  const around = (middle, reach, visit) => {
    const d = middle.map((x, r) => x - origin[r]);
    const ranges = axes.map((axis, a) => {
      const at = (axis[0] * d[0] + axis[1] * d[1] + axis[2] * d[2]) / kSpacing_mm ** 2;
      const steps = reach / kSpacing_mm;
      return [Math.max(0, Math.ceil(at - steps)), Math.min(kSize[a] - 1, Math.floor(at + steps))];
    });
    for (let k = ranges[2][0]; k <= ranges[2][1]; ++k)
      for (let j = ranges[1][0]; j <= ranges[1][1]; ++j)
        for (let i = ranges[0][0]; i <= ranges[0][1]; ++i) visit(i + kSize[0] * (j + kSize[1] * k), place(i, j, k));
  };
  for (const vessel of vessels(random)) {
    const [from, to, radius] = vessel;
    const middle = from.map((x, r) => (x + to[r]) / 2);
    const reach = Math.hypot(...from.map((x, r) => x - to[r])) / 2 + radius + kSpacing_mm;
    around(middle, reach, (at, p) => {
      const share = Math.min(1, Math.max(0, 0.8 - distance(p, vessel) / kSpacing_mm));
      voxels[at] = Math.max(voxels[at], 95 + 90 * share);
    });
  }
  for (const [centre, radius, inside] of kLesions) {
    around(centre, radius, (at, p) => {
      const d = Math.hypot(...p.map((x, r) => x - centre[r]));
      if (d < radius) voxels[at] = d > radius - 3 ? 135 : inside;
    });
  }
  for (let at = 0; at < voxels.length; ++at) voxels[at] += 22 * (random() + random() + random() - 1.5);
  const vector = (v) => `(${v.join(",")})`;
  const header =
    `NRRD0004\ntype: short\ndimension: 3\nspace: left-posterior-superior\nsizes: ${kSize.join(" ")}\n` +
    `space directions: ${axes.map(vector).join(" ")}\nkinds: domain domain domain\nendian: little\nencoding: gzip\n` +
    `space origin: ${vector(origin)}\n\n`;
  writeFileSync(path, Buffer.concat([Buffer.from(header), gzipSync(Buffer.from(voxels.buffer))]));
  return path;
}
