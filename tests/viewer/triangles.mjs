// The triangles of a page and of a file, to be compared.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";

/** Each triangle (9 numbers) as one text, its corners from the least on; sorted. */
export function canonical(corners) {
  const triangles = [];
  for (let i = 0; i < corners.length; i += 9) {
    const points = [0, 3, 6].map((k) => Array.from(corners.subarray(i + k, i + k + 3)).join(" "));
    const least = points.indexOf([...points].sort()[0]);
    triangles.push([0, 1, 2].map((k) => points[(least + k) % 3]).join(" | "));
  }
  return triangles.sort();
}

/** The data arrays of a .vtu file as Incise writes it: appended, raw, sizes in 64 bits. */
function readVtu(path) {
  const bytes = readFileSync(path);
  const begin = bytes.indexOf("_", bytes.indexOf("<AppendedData")) + 1;
  const header = bytes.toString("latin1", 0, begin);
  const types = { Float64: Float64Array, Int64: BigInt64Array, UInt8: Uint8Array };
  const array = (name) => {
    const [, type, offset] = new RegExp(`type="(\\w+)" Name="${name}"[^>]* offset="(\\d+)"`).exec(header);
    const at = begin + Number(offset);
    const size = Number(bytes.readBigUInt64LE(at));
    return new types[type](new Uint8Array(bytes.subarray(at + 8, at + 8 + size)).buffer);
  };
  return { points: array("Points"), corners: Array.from(array("connectivity"), Number), cutMask: array("cut_mask") };
}

/** The boundary of a .vtu file's tetrahedra: faces of one tetrahedron only, and both sides of cut faces, seen from outside. */
export function boundaryOfVtu(path) {
  const { points, corners, cutMask } = readVtu(path);
  const outward = [
    [1, 2, 3],
    [0, 3, 2],
    [0, 1, 3],
    [0, 2, 1],
  ]; // of the face opposite to each corner
  const sides = new Map(); // from three vertices to the faces that have them
  for (let tet = 0; tet < cutMask.length; ++tet) {
    outward.forEach((face, k) => {
      const vertices = face.map((i) => corners[4 * tet + i]);
      const key = [...vertices].sort((a, b) => a - b).join();
      sides.set(key, [...(sides.get(key) ?? []), { vertices, cut: ((cutMask[tet] >> k) & 1) === 1 }]);
    });
  }
  const boundary = [];
  for (const faces of sides.values()) {
    assert.ok(faces.length <= 2);
    for (const { vertices, cut } of faces) {
      if (faces.length === 1 || cut)
        boundary.push(...vertices.flatMap((v) => Array.from(points.subarray(3 * v, 3 * v + 3))));
    }
  }
  return Float32Array.from(boundary);
}
