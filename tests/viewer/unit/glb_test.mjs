// The file of the surface for other programs, as three.js reads it.

import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./modules.mjs";

const { toGlb, BodyMesh, allocateCorners, Box3, GLTFLoader } = await load(
  "glb",
  "body_mesh",
  "corner_buffers",
  "../node_modules/three",
  "../node_modules/three/examples/jsm/loaders/GLTFLoader.js",
);

// What a browser has and Node has not.
globalThis.self = globalThis;
globalThis.FileReader = class {
  async readAsArrayBuffer(blob) {
    this.result = await blob.arrayBuffer();
    this.onloadend();
  }
};

/** Tetrahedra beside each other, one a piece; these faces of each are cut faces. A free slot is between them. */
function tetrahedra(cuts) {
  const faces = [
    [0, 2, 1],
    [0, 1, 3],
    [1, 2, 3],
    [0, 3, 2],
  ];
  const corners = allocateCorners(5 * cuts.length);
  for (const [piece, cut] of cuts.entries()) {
    const points = [
      [1 + 2 * piece, 1, 1],
      [2 + 2 * piece, 1, 1],
      [1 + 2 * piece, 2, 1],
      [1 + 2 * piece, 1, 3],
    ];
    for (const [f, face] of faces.entries()) {
      const slot = 5 * piece + f;
      corners.positions.set(
        face.flatMap((v) => points[v]),
        9 * slot,
      );
      for (let k = 0; k < 3; ++k) {
        corners.normals.set([0, 0, 32767, 99], 12 * slot + 4 * k);
        corners.facts.set([Number(cut.includes(f)), 0, piece, 0], 12 * slot + 4 * k);
      }
    }
  }
  const body = new BodyMesh();
  body.replace(5 * cuts.length, 64, corners);
  return body;
}

test("a GLB has a node for each piece, with its triangles as skin and as cut faces, and unit normals", async () => {
  const body = tetrahedra([[2], [], [0, 1, 2, 3], [1, 3]]);
  const { scene } = await new GLTFLoader().parseAsync(await toGlb(body, "liver"), "");
  const root = scene.getObjectByName("liver");
  const found = root.children.map((piece) => {
    const counts = { name: piece.name, skin: 0, cut: 0 };
    piece.traverse((part) => {
      if (!part.isMesh) return;
      counts[part.material.name] += part.geometry.index.count / 3;
      assert.deepEqual([...part.geometry.getAttribute("normal").array.slice(0, 3)], [0, 0, 1]);
    });
    return counts;
  });
  assert.deepEqual(found, [
    { name: "piece_1", skin: 3, cut: 1 },
    { name: "piece_2", skin: 4, cut: 0 },
    { name: "piece_3", skin: 0, cut: 4 },
    { name: "piece_4", skin: 2, cut: 2 },
  ]);
  const upright = new Box3().setFromObject(scene);
  near(upright.max.toArray(), [8, 3, -1]); // y is up in glTF
  root.rotation.set(0, 0, 0);
  const box = new Box3().setFromObject(scene);
  assert.deepEqual(
    [box.min.toArray(), box.max.toArray()],
    [
      [1, 1, 1],
      [8, 2, 3],
    ],
  );
});

function near(found, wanted) {
  for (const [i, x] of found.entries()) assert.ok(Math.abs(x - wanted[i]) < 1e-6, `${found}, wanted ${wanted}`);
}
