// Bodies with something inside, for tests and pictures: a volume image with a formula, a block of layers.

import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { gzipSync } from "node:zlib";

/** What the image of writeRamp() has at (x, y, z), metres of the body: 0 to 1 in a cube of 10 cm at the origin. */
export const rampAt = ([x, y, z]) => x + 3 * y + 6 * z;

/**
 * Writes ramp.nrrd to a folder: rampAt() in float voxels, in millimetres of RAS, along axes that are oblique, with gzip. It covers places with x from 1 cm on of the
 * cube of 10 cm at the origin, and more.
 */
export function writeRamp(folder) {
  const size = [60, 70, 40];
  // Directions of the axes in LPS, mm; the second is longer than the others.
  const turn = 0.3;
  const axes = [
    [2 * Math.cos(turn), 2 * Math.sin(turn), 0],
    [-2.5 * Math.sin(turn), 2.5 * Math.cos(turn), 0],
    [0, 0.2, 4],
  ];
  const origin = [40, -70, -30];
  const voxels = new Float32Array(size[0] * size[1] * size[2]);
  let at = 0;
  for (let k = 0; k < size[2]; ++k)
    for (let j = 0; j < size[1]; ++j)
      for (let i = 0; i < size[0]; ++i)
        voxels[at++] =
          1000 * rampAt([0, 1, 2].map((r) => 1e-3 * (origin[r] + axes[0][r] * i + axes[1][r] * j + axes[2][r] * k)));
  const ras = ([x, y, z]) => `(${-x},${-y},${z})`;
  const header =
    `NRRD0005\ntype: float\ndimension: 3\nspace: right-anterior-superior\nsizes: ${size.join(" ")}\n` +
    `space directions: ${axes.map(ras).join(" ")}\nkinds: domain domain domain\nendian: little\nencoding: gzip\n` +
    `space origin: ${ras(origin)}\n\n`;
  const path = join(folder, "ramp.nrrd");
  writeFileSync(path, Buffer.concat([Buffer.from(header), gzipSync(Buffer.from(voxels.buffer))]));
  return { path, covers: (p) => insideOf(p, origin, axes, size) };
}

/** How far within the image's box a place is, in voxels; below 0: outside. */
function insideOf(p, origin, axes, size) {
  const w = p.map((x, r) => 1000 * x - origin[r]);
  // The axes but for the third's small y are at right angles.
  const k = w[2] / axes[2][2];
  const v = [w[0], w[1] - k * axes[2][1]];
  const along = (a) => (v[0] * a[0] + v[1] * a[1]) / (a[0] * a[0] + a[1] * a[1]);
  const index = [along(axes[0]), along(axes[1]), k];
  return Math.min(...index.map((x, i) => Math.min(x + 0.5, size[i] - 0.5 - x)));
}

/**
 * Writes NAME.node and NAME.ele to a folder: a block of 12 x 12 x 8 cm of `n` cells along x, whose region attribute is 1 (skin) in the uppermost cells, 2 (fat)
 * below, then 3 (muscle), with a ball of 4.
 */
export function writeLayers(folder, n = 18, name = "layers") {
  const size = [0.12, 0.12, 0.08];
  const cells = [n, n, Math.round((n * 2) / 3)];
  const nodes = [],
    tets = [];
  const id = (i, j, k) => i + (cells[0] + 1) * (j + (cells[1] + 1) * k);
  for (let k = 0; k <= cells[2]; ++k)
    for (let j = 0; j <= cells[1]; ++j)
      for (let i = 0; i <= cells[0]; ++i)
        nodes.push([i, j, k].map((c, a) => (size[a] * c) / cells[a] - (a < 2 ? size[a] / 2 : 0)));
  const regionOf = ([x, y, z]) => {
    const depth = 1 - z / size[2];
    if (Math.hypot(x - 0.01, y, z - 0.03) < 0.016) return 4;
    return depth < 1 / cells[2] ? 1 : depth < 4 / cells[2] ? 2 : 3;
  };
  // Six tetrahedra around a cube's diagonal (Kuhn 1960).
  const orders = [
    [0, 1, 2],
    [1, 2, 0],
    [2, 0, 1],
    [0, 2, 1],
    [2, 1, 0],
    [1, 0, 2],
  ];
  for (let k = 0; k < cells[2]; ++k)
    for (let j = 0; j < cells[1]; ++j)
      for (let i = 0; i < cells[0]; ++i)
        for (const [o, order] of orders.entries()) {
          const c = [i, j, k];
          const corners = [id(...c)];
          for (const axis of order) {
            ++c[axis];
            corners.push(id(...c));
          }
          if (o >= 3) [corners[2], corners[3]] = [corners[3], corners[2]];
          const middle = [0, 1, 2].map((a) => corners.reduce((sum, v) => sum + nodes[v][a], 0) / 4);
          tets.push([...corners, regionOf(middle)]);
        }
  const rows = (list, head) => `${head}\n${list.map((row, i) => `${i} ${row.join(" ")}`).join("\n")}\n`;
  writeFileSync(join(folder, `${name}.node`), rows(nodes, `${nodes.length} 3 0 0`));
  writeFileSync(join(folder, `${name}.ele`), rows(tets, `${tets.length} 4 1`));
  return join(folder, name);
}

export const layerMaterials = [
  { region: 1, tissue: "skin" },
  { region: 2, tissue: "fat" },
  { region: 3, tissue: "muscle" },
  { region: 4, tissue: "tumour" },
];
