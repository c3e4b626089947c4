// A body with a texture, for tests.

import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { deflateSync } from "node:zlib";

/** A PNG of these pixels, rows from above: [[r, g, b], ...] each. */
function png(rows) {
  const chunk = (type, data) => {
    const body = Buffer.concat([Buffer.from(type), data]);
    const frame = Buffer.alloc(body.length + 8);
    frame.writeUInt32BE(data.length);
    body.copy(frame, 4);
    frame.writeUInt32BE(crc32(body), body.length + 4);
    return frame;
  };
  const head = Buffer.from([0, 0, 0, rows[0].length, 0, 0, 0, rows.length, 8, 2, 0, 0, 0]);
  const data = deflateSync(Buffer.from(rows.flatMap((row) => [0, ...row.flat()])));
  return Buffer.concat([
    Buffer.from([137, 80, 78, 71, 13, 10, 26, 10]),
    chunk("IHDR", head),
    chunk("IDAT", data),
    chunk("IEND", Buffer.alloc(0)),
  ]);
}

function crc32(bytes) {
  let crc = ~0;
  for (const byte of bytes) {
    crc ^= byte;
    for (let k = 0; k < 8; ++k) crc = crc & 1 ? (crc >>> 1) ^ 0xedb88320 : crc >>> 1;
  }
  return ~crc >>> 0;
}

/**
 * Writes cube.obj, cube.mtl and paint.png to a folder: a cube of 10 cm whose sides are green below and blue above. Texture coordinates: v is the height, u
 * says which side it is, so that each edge but the vertical ones' v is a seam. The top and the bottom are of another material.
 */
export function paintedCube(folder) {
  const n = 6;
  const green = [30, 200, 40],
    blue = [30, 60, 220];
  let text = "mtllib cube.mtl\n";
  let corner = 0;
  for (let side = 0; side < 6; ++side) {
    const axis = side >> 1;
    text += `usemtl ${axis === 2 ? "lid" : "painted"}\n`;
    const at = (i, j) => {
      const p = [0, 0, 0];
      p[axis] = side % 2 ? 0.1 : 0;
      p[(axis + 1) % 3] = 0.1 * (i / n);
      p[(axis + 2) % 3] = 0.1 * (j / n);
      text += `v ${p.join(" ")}\nvt ${uOf(side)} ${p[2] / 0.1}\n`;
      ++corner;
      return `${corner}/${corner}`;
    };
    for (let i = 0; i < n; ++i) {
      for (let j = 0; j < n; ++j) {
        const c = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        text += `f ${(side % 2 ? c : c.reverse()).join(" ")}\n`;
      }
    }
  }
  writeFileSync(join(folder, "cube.obj"), text);
  writeFileSync(join(folder, "cube.mtl"), "newmtl painted\nmap_Kd paint.png\nnewmtl lid\nKd 0.9 0.8 0.1\n");
  writeFileSync(join(folder, "paint.png"), png([0, 1, 2, 3].map((row) => Array(4).fill(row < 2 ? blue : green))));
}

/** Sides -x, +x, -y, +y, -z, +z are 0 to 5. */
export const uOf = (side) => (side + 0.5) / 6;
