// The texture of the surface that the body was filled from, on the cut body.

import assert from "node:assert/strict";
import { test } from "node:test";
import { fill, json, load, vectors } from "./modules.mjs";

const { SurfaceAsset, Surface, CornerBuilder, allocateCorners, httpAddress } = await load(
  "surface_asset",
  "surface",
  "corner_buffers",
  "texture_source",
);
const bytes = (name) => Uint8Array.from(vectors(`messages/${name}.bin`));
const asset = new SurfaceAsset(bytes("SurfaceAsset"));
const faces = json("surface_lookup.json");
const near = (a, b, text) => assert.ok(Math.abs(a - b) < 1e-5, `${text}: ${a} instead of ${b}`);

test("texture coordinates of faces are those that every client finds", () => {
  assert.ok(faces.length >= 6);
  for (const { what, origin, rest, uvs } of faces) {
    const out = new Float32Array(6);
    assert.equal(asset.cornerUvs(origin, rest.flat(), out), uvs !== null, what);
    for (const [i, expected] of (uvs ?? []).flat().entries()) near(out[i], expected, what);
  }
  assert.deepEqual(asset.materials[1], { name: "liver", diffuse: [1, 1, 1], texture: "1.png" });
});

test("bytes that are no surface are refused", () => {
  assert.throws(() => new SurfaceAsset(bytes("Ping")), /another kind/);
  assert.throws(() => new SurfaceAsset(new Uint8Array(40)), /no message/);
  assert.throws(() => new SurfaceAsset(new Uint8Array(0)), /no message/);
});

test("corners have the texture of where their material is at rest", () => {
  const { rest, uvs, origin } = faces[1];
  const moved = rest.map((p) => p.map((x) => x + 0.3));
  const surface = fill(new Surface(), moved, [
    { v: [0, 1, 2], origin },
    { v: [0, 2, 1], cut: true },
  ]);
  const table = { idsArray: () => Uint32Array.of(0, 1, 2), positionsArray: () => Float32Array.from(rest.flat()) };
  assert.equal(surface.setRest(table), true);
  assert.equal(
    surface.setRest({ idsArray: () => Uint32Array.of(7), positionsArray: () => new Float32Array(3) }),
    false,
  );
  const builder = new CornerBuilder(surface);
  builder.restart();
  builder.measureAll();
  builder.asset = asset;
  const out = allocateCorners(2, true);
  builder.write(0, out, 0);
  builder.write(1, out, 1);
  for (let k = 0; k < 3; ++k) {
    near(out.texture[3 * k], uvs[k][0], "u");
    near(out.texture[3 * k + 1], uvs[k][1], "v");
    assert.equal(out.texture[3 * k + 2], asset.materialOf[origin]);
    assert.equal(out.texture[9 + 3 * k + 2], -1);
  }
  // A vertex that leaves the surface and comes back rests where it then is.
  surface.removeTriangles(Uint32Array.of(0, 4));
  surface.removeVertices(Uint32Array.of(0, 1, 2));
  fill(surface, rest, [{ v: [0, 1, 2], origin }]);
  const corners = new Float32Array(9);
  surface.restCorners(surface.slotFor(0), corners);
  assert.deepEqual([...corners], [...Float32Array.from(rest.flat())]);
});

test("the asset is where the page's server is", () => {
  assert.equal(httpAddress("ws://127.0.0.1:7480/ws"), "http://127.0.0.1:7480");
  assert.equal(httpAddress("wss://a.example/ws?x"), "https://a.example");
});
