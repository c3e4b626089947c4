// The page's modules as Node runs them, and what their tests share.

import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { fileURLToPath } from "node:url";

const root = new URL("../../../", import.meta.url);
const require = createRequire(new URL("client/viewer/package.json", root));
const { buildSync } = require("esbuild");

/** The exports of these modules of client/viewer/src, in one bundle: what they share is the same for all. */
export async function load(...names) {
  const contents = names.map((name) => `export * from "./${name}";`).join("\n");
  const built = buildSync({
    stdin: { contents, resolveDir: fileURLToPath(new URL("client/viewer/src", root)), loader: "ts" },
    bundle: true,
    format: "esm",
    write: false,
    logLevel: "warning",
  });
  return import(`data:text/javascript;base64,${Buffer.from(built.outputFiles[0].contents).toString("base64")}`);
}

export const vectors = (name) => readFileSync(new URL(`protocol/vectors/${name}`, root));
export const json = (name) => JSON.parse(vectors(name).toString());

/** The messages that a client of view Surface gets over TCP, without their lengths; each in an aligned buffer of its own. */
export function surfaceStream() {
  const bytes = vectors("streams/surface.bin");
  const messages = [];
  for (let at = 0; at < bytes.length; ) {
    const size = bytes.readUInt32LE(at);
    messages.push(Uint8Array.from(bytes.subarray(at + 4, at + 4 + size)));
    at += 4 + size;
  }
  return messages;
}

/** Uniform numbers in [0, 1) that a seed determines (Mulberry32). */
export function random(seed) {
  return () => {
    seed = (seed + 0x6d2b79f5) | 0;
    let t = Math.imul(seed ^ (seed >>> 15), 1 | seed);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
}

/** A surface of these vertices and triangles: [[x, y, z], ...], [{ v: [a, b, c], cut, piece, id }, ...]. */
export function fill(surface, vertices, triangles) {
  const good =
    surface.setVertices({
      idsArray: () => Uint32Array.from(vertices.keys()),
      positionsArray: () => Float32Array.from(vertices.flat()),
    }) &&
    surface.setTriangles({
      idsArray: () => Uint32Array.from(triangles, (t, i) => t.id ?? 4 * i),
      verticesArray: () => Uint32Array.from(triangles.flatMap((t) => t.v)),
      flagsArray: () => Uint8Array.from(triangles, (t) => Number(t.cut ?? false)),
      piecesArray: () => Uint32Array.from(triangles, (t) => t.piece ?? 0),
      regionsArray: () => Int32Array.from(triangles, (t) => t.region ?? 0),
      originsArray: () =>
        triangles.some((t) => t.origin >= 0) ? Uint32Array.from(triangles, (t) => t.origin ?? 0xffffffff) : null,
    });
  if (!good) throw new Error("the arrays do not fit");
  return surface;
}
