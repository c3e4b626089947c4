// What `incise cut` and `incise export` write of a body with a texture, as other programs read it: .glb by three.js's GLTFLoader, .vtu and .vtp by VTK.

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { paintedCube, uOf } from "./painted.mjs";
import { bin } from "./server.mjs";
import { load } from "./unit/modules.mjs";

const { GLTFLoader, Vector3, Mesh } = await load(
  "../node_modules/three",
  "../node_modules/three/examples/jsm/loaders/GLTFLoader.js",
);

// What a browser has and Node has not. An image is its bytes.
globalThis.self = globalThis;
globalThis.ProgressEvent ??= class extends Event {};
globalThis.createImageBitmap = async (blob) => ({ bytes: new Uint8Array(await blob.arrayBuffer()), close() {} });

const folder = mkdtempSync(join(tmpdir(), "incise_export_"));
after(() => rmSync(folder, { recursive: true }));
const file = (name) => join(folder, name);

function run(...args) {
  const done = spawnSync(join(bin, "incise"), args, { encoding: "utf8" });
  assert.ok(done.status === 0, `incise ${args.join(" ")}: ${done.stderr}`);
  return done;
}

const cut = (mesh, out) =>
  run("cut", "--mesh", mesh, "--poses", file("poses.csv"), "--blade", "0,0,0.05:0,0,-0.2", "--out", out);

before(() => {
  paintedCube(folder);
  // Two strokes right through, which meet at a slant.
  const rows = ["t_s,x_m,y_m,z_m,qw,qx,qy,qz"];
  for (const [stroke, [from, to]] of [
    [
      [0.06, -0.02],
      [0.05, 0.12],
    ],
    [
      [-0.02, 0.03],
      [0.12, 0.05],
    ],
  ].entries()) {
    for (let i = 0; i <= 60; ++i) {
      const at = [0, 1].map((k) => from[k] + ((to[k] - from[k]) * i) / 60);
      rows.push([stroke * 100 + i * 0.01, ...at, 0.1, 1, 0, 0, 0].join());
    }
  }
  writeFileSync(file("poses.csv"), `${rows.join("\n")}\n`);
});

async function read(name) {
  const bytes = readFileSync(file(name));
  return new GLTFLoader().parseAsync(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length), "");
}

/** Calls visit(places, normals, uvs) for each triangle of a mesh, in the body's frame: z upwards. */
function forTriangles(mesh, visit) {
  const { index, attributes } = mesh.geometry;
  const turn = (v) => new Vector3(v.x, -v.z, v.y);
  for (let i = 0; i < index.count; i += 3) {
    const corners = [0, 1, 2].map((k) => index.getX(i + k));
    const places = corners.map((c) =>
      turn(new Vector3().fromBufferAttribute(attributes.position, c).applyMatrix4(mesh.matrixWorld)),
    );
    const normals = corners.map((c) =>
      turn(new Vector3().fromBufferAttribute(attributes.normal, c).transformDirection(mesh.matrixWorld)),
    );
    const uvs = attributes.uv && corners.map((c) => [attributes.uv.getX(c), 1 - attributes.uv.getY(c)]);
    visit(places, normals, uvs);
  }
}

test("a .glb has the pieces as nodes, the materials by name, the texture with its seams, and normals with creases at the rims", async () => {
  cut(file("cube.obj"), file("cut.glb"));
  const gltf = await read("cut.glb");
  gltf.scene.updateMatrixWorld(true);
  const body = gltf.scene.children[0];
  assert.equal(body.name, "body");
  assert.equal(body.children.length, 4);
  let volume = 0,
    outside = 0;
  const images = new Set();
  for (const piece of body.children) {
    assert.match(piece.name, /^piece_[0-3]$/);
    const meshes = piece instanceof Mesh ? [piece] : piece.children;
    assert.deepEqual(meshes.map((m) => m.material.name).sort(), ["inside", "lid", "painted"]);
    let own = 0;
    for (const mesh of meshes) {
      const { name, map, color } = mesh.material;
      assert.equal(map !== null, name === "painted", name);
      if (map) images.add(Buffer.from(map.image.bytes).toString("base64"));
      if (name === "lid")
        for (const [k, x] of [0.9, 0.8, 0.1].entries())
          assert.ok(Math.abs(color.clone().convertLinearToSRGB().toArray()[k] - x) < 1e-5);
      forTriangles(mesh, ([a, b, c], normals, uvs) => {
        own += a.dot(b.clone().cross(c)) / 6;
        const face = b.clone().sub(a).cross(c.clone().sub(a)).normalize();
        for (const n of normals) {
          assert.ok(Math.abs(n.length() - 1) < 1e-4);
          assert.ok(n.dot(face) > 0.7, `${name}: a normal ${Math.acos(n.dot(face))} off its face`);
        }
        assert.equal(uvs !== undefined && name !== "inside", name !== "inside");
        if (name === "inside") return;
        ++outside;
        const axis = [0, 1, 2].find((k) => Math.abs(face.toArray()[k]) > 0.999);
        assert.notEqual(axis, undefined, "the sides are flat");
        const side = 2 * axis + Number(face.toArray()[axis] > 0);
        assert.equal(name, axis === 2 ? "lid" : "painted");
        for (const [k, place] of [a, b, c].entries()) {
          assert.ok(Math.abs(uvs[k][0] - uOf(side)) < 1e-5, "no triangle reaches over a seam");
          assert.ok(Math.abs(uvs[k][1] - place.z / 0.1) < 1e-4, `v ${uvs[k][1]} at z ${place.z}`);
        }
      });
    }
    assert.ok(own > 0.05e-3, `${piece.name} is closed and has ${own} m3`);
    volume += own;
  }
  assert.ok(Math.abs(volume - 1e-3) < 1e-6, `${volume} m3`);
  assert.ok(outside > 400);
  assert.deepEqual([...images], [readFileSync(file("paint.png")).toString("base64")]);
});

test("a .glb of a body without a surface has an outside and an inside", async () => {
  run("phantom", "slab", "--size", "2000", "--out", file("slab.vtu"));
  run("phantom", "slab", "--size", "2000", "--out", file("slab.glb"));
  const whole = await read("slab.glb");
  assert.deepEqual(
    whole.scene.children[0].children.map((m) => [m.name, m.material.name]),
    [["piece_0", "outside"]],
  );
  const refused = spawnSync(join(bin, "incise"), ["phantom", "slab", "--out", join(folder, "none", "a.glb")], {
    encoding: "utf8",
  });
  assert.equal(refused.status !== 0 && refused.stderr.trim().split("\n").length, 1, refused.stderr);
  assert.match(refused.stderr, /make it first \(mkdir -p/);
  const other = spawnSync(join(bin, "incise"), ["phantom", "slab", "--out", file("a.gltf")], { encoding: "utf8" });
  assert.match(other.stderr, /cannot write "\.gltf"; choose .*\.glb/);
});

test("a capture is exported as a .glb, too", async () => {
  writeFileSync(
    file("config.json"),
    JSON.stringify({
      mesh: { path: file("cube.obj"), target_tets: 3000 },
      blade: { heel: [0, 0, 0.05], tip: [0, 0, -0.2] },
      cut: { engage: "always" },
    }),
  );
  run("convert", file("poses.csv"), "--config", file("config.json"), "--out", file("a.capture"));
  run("export", file("a.capture"), "--out", file("exported.glb"));
  const gltf = await read("exported.glb");
  assert.equal(gltf.scene.children[0].children.length, 4);
  run("export", file("a.capture"), "--revision", "0", "--out", file("uncut.glb"));
  assert.equal((await read("uncut.glb")).scene.children[0].children.length, 1);
});

const python = (script, ...args) => spawnSync("/usr/bin/python3", ["-c", script, ...args], { encoding: "utf8" });
const vtkMissing = python("import vtk").status === 0 ? false : "needs the Debian package python3-vtk9";

test("VTK reads origins of the faces from a .vtu, and texture coordinates from a .vtp", { skip: vtkMissing }, () => {
  cut(file("cube.obj"), file("cut.vtu"));
  cut(file("cube.obj"), file("cut.vtp"));
  const done = python(
    `
import sys, vtk
from vtk.util.numpy_support import vtk_to_numpy as numbers
import numpy as np
def read(reader, name):
    reader.SetFileName(name)
    reader.Update()
    return reader.GetOutput()
grid = read(vtk.vtkXMLUnstructuredGridReader(), sys.argv[1])
points = numbers(grid.GetPoints().GetData())
tets = numbers(grid.GetCells().GetConnectivityArray()).reshape(-1, 4)
data = grid.GetCellData()
origins = [numbers(data.GetArray(f"origin_{f}")) for f in range(4)]
faces = [(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)]
n = 0
for f in range(4):
    has = origins[f] != 4294967295
    corners = points[tets[has][:, faces[f]]]
    flat = (np.ptp(corners, axis=1) < 1e-9).any(axis=1)
    assert flat.all(), "a face with an origin lies in a side of the cube"
    side = origins[f][has] // 72
    axis = side // 2
    at = corners[np.arange(len(axis)), 0, axis]
    assert np.allclose(at, 0.1 * (side % 2), atol=1e-9), "its origin is in that side"
    assert not (numbers(data.GetArray("cut_mask"))[has] >> f & 1).any()
    n += has.sum()
assert n > 400, n
surface = read(vtk.vtkXMLPolyDataReader(), sys.argv[2])
points = numbers(surface.GetPoints().GetData())
uv = numbers(surface.GetPointData().GetTCoords())
triangles = numbers(surface.GetPolys().GetConnectivityArray()).reshape(-1, 3)
outside = numbers(surface.GetCellData().GetArray("cut")) == 0
assert outside.sum() == n
t = triangles[outside]
assert np.ptp(uv[t][:, :, 0], axis=1).max() < 1e-5, "a triangle over a seam"
assert np.abs(uv[t][:, :, 1] - points[t][:, :, 2] / 0.1).max() < 1e-4
print("good")
`,
    file("cut.vtu"),
    file("cut.vtp"),
  );
  assert.equal(done.stdout.trim(), "good", done.stderr);
});
