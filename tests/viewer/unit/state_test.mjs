// What the page holds of the stream's state: hash, map of ids, surface, replica, elements.

import assert from "node:assert/strict";
import { test } from "node:test";
import { fill, json, load, random, surfaceStream } from "./modules.mjs";

const {
  StateHash,
  hex,
  IdMap,
  Surface,
  withRoom,
  Replica,
  Elements,
  kSurfaceTriangle,
  kSurfaceVertex,
  Message,
  SnapshotBegin,
  SnapshotChunk,
  SnapshotEnd,
  SurfaceDelta,
  Welcome,
  ByteBuffer,
} = await load(
  "state_hash",
  "id_map",
  "surface",
  "replica",
  "elements",
  "wire/incise/wire/message",
  "wire/incise/wire/snapshot-begin",
  "wire/incise/wire/snapshot-chunk",
  "wire/incise/wire/snapshot-end",
  "wire/incise/wire/surface-delta",
  "wire/incise/wire/welcome",
  "../node_modules/flatbuffers",
);

test("the hash of surface elements is the protocol's", () => {
  const vectors = json("hashes.json");
  const bits = (x) => new Uint32Array(Float32Array.of(x).buffer)[0];
  const hashOf = (kind, words) => {
    const hash = new StateHash();
    hash.toggle(kind, words, words.length);
    return hex(hash.value);
  };
  assert.ok(vectors.triangle.length > 0 && vectors.surface_vertex.length > 0);
  for (const t of vectors.triangle)
    assert.equal(hashOf(kSurfaceTriangle, [t.id ?? t.half_face, ...t.vertices, t.flags]), t.hash);
  for (const v of vectors.surface_vertex) assert.equal(hashOf(kSurfaceVertex, [v.id, ...v.position.map(bits)]), v.hash);
});

test("adding an element twice takes it out of the hash", () => {
  const hash = new StateHash();
  hash.toggle(3, [1, 2, 3, 4, 0], 5);
  const one = hash.value;
  hash.toggle(3, [5, 6, 7, 8, 1], 5);
  assert.notEqual(hash.value, one);
  hash.toggle(3, [5, 6, 7, 8, 1], 5);
  assert.equal(hash.value, one);
  assert.equal(hex(1n), "0000000000000001");
});

test("the map of ids does what a Map does", () => {
  for (const seed of [1, 2, 3]) {
    const next = random(seed);
    const map = new IdMap(),
      wanted = new Map();
    for (let step = 0; step < 20_000; ++step) {
      const id = Math.floor(next() * 3000) * 1024; // far apart, so that places collide
      if (wanted.has(id)) {
        if (next() < 0.7) {
          map.remove(id);
          wanted.delete(id);
        }
      } else {
        map.add(id, step);
        wanted.set(id, step);
      }
      assert.equal(map.get(id), wanted.get(id) ?? -1, `seed ${seed}, step ${step}`);
    }
    assert.equal(map.size, wanted.size);
    for (const [id, slot] of wanted) assert.equal(map.get(id), slot, `seed ${seed}`);
    map.clear();
    assert.equal(map.size, 0);
    for (const id of wanted.keys()) assert.equal(map.get(id), -1);
  }
});

test("a grown array keeps what it held", () => {
  const array = Float32Array.from([1, 2, 3]);
  assert.equal(withRoom(array, 3), array);
  const grown = withRoom(array, 4);
  assert.ok(grown.length >= 4);
  assert.deepEqual([...grown.subarray(0, 4)], [1, 2, 3, 0]);
});

const square = [
  [0, 0, 0],
  [1, 0, 0],
  [1, 1, 0],
  [0, 1, 0],
];

test("a surface changed back and forth has the hash that it had", () => {
  const surface = fill(new Surface(), square, [{ v: [0, 1, 2] }, { v: [0, 2, 3], piece: 1 }]);
  assert.deepEqual([surface.triangleCount, surface.pieceCount, surface.vertexCount, surface.slots], [2, 2, 4, 2]);
  const hash = surface.surfaceHash;
  surface.removeTriangles(Uint32Array.of(4));
  surface.removeVertices(Uint32Array.of(3));
  assert.deepEqual([surface.triangleCount, surface.pieceCount, surface.vertexCount], [1, 1, 3]);
  assert.notEqual(surface.surfaceHash, hash);
  surface.clearTouched();
  fill(surface, square, [{ v: [0, 1, 2] }, { v: [0, 2, 3], piece: 1 }]);
  assert.equal(surface.surfaceHash, hash);
  assert.equal(surface.slots, 2); // the free slot was used again
  assert.ok(surface.touchedSlots.has(1) && surface.touchedVertices.has(3));
  surface.removeTriangles(Uint32Array.of(4));
  surface.clear();
  assert.equal(surface.surfaceHash, 0n);
  fill(surface, square, [{ v: [0, 1, 2] }]);
  assert.deepEqual([surface.slots, surface.ids[0]], [1, 0]); // no slot from before is free
});

test("a piece is counted until its last triangle has gone", () => {
  const surface = fill(new Surface(), square, [
    { v: [0, 1, 2], piece: 5 },
    { v: [0, 2, 3], piece: 5 },
  ]);
  const counts = [0, 4].map((id) => {
    surface.removeTriangles(Uint32Array.of(id));
    return surface.pieceCount;
  });
  assert.deepEqual(counts, [1, 0]);
});

test("the corners at a vertex are those of its triangles", () => {
  const surface = fill(new Surface(), square, [{ v: [0, 1, 2] }, { v: [0, 2, 3] }]);
  const at = (v) => {
    const slots = [];
    for (let c = surface.head[v]; c !== 0xffffffff; c = surface.next[c]) slots.push((c / 3) | 0);
    return slots.sort();
  };
  assert.deepEqual([0, 1, 2, 3].map(at), [[0, 1], [0], [0, 1], [1]]);
  surface.removeTriangles(Uint32Array.of(0));
  assert.deepEqual([0, 1, 2].map(at), [[1], [], [1]]);
});

test("arrays that do not belong together are refused", () => {
  const surface = fill(new Surface(), square, [{ v: [0, 1, 2] }]);
  assert.throws(() => fill(surface, square, [{ v: [0, 1, 9] }])); // no such vertex
  assert.equal(
    surface.setVertices({ idsArray: () => Uint32Array.of(1, 2), positionsArray: () => new Float32Array(3) }),
    false,
  );
  const triangle = {
    idsArray: () => Uint32Array.of(8),
    verticesArray: () => Uint32Array.of(0, 1, 2),
    flagsArray: () => Uint8Array.of(0),
    piecesArray: () => Uint32Array.of(0),
    regionsArray: () => Int32Array.of(0),
    originsArray: () => null,
  };
  for (const name of ["verticesArray", "flagsArray", "piecesArray", "regionsArray", "originsArray"])
    assert.equal(surface.setTriangles({ ...triangle, [name]: () => new Uint32Array(9) }), false, name);
  assert.equal(surface.setTriangles(triangle), true);
  const removed = fill(new Surface(), square, []);
  removed.removeVertices(Uint32Array.of(2));
  assert.throws(() => fill(removed, [], [{ v: [0, 1, 2] }]));
});

/** A replica, and what it asks of the server. `spoil` may change a message's bytes before it is read. */
function follow(messages, spoil = () => {}) {
  const asked = [];
  const replica = new Replica((_revision, _hash, reason) => asked.push(reason));
  const states = [];
  for (const [i, bytes] of messages.entries()) {
    spoil(i, bytes);
    const message = Message.getRootAsMessage(new ByteBuffer(bytes));
    const body = (Type) => message.body(new Type());
    const take = {
      Welcome: () => replica.welcome(body(Welcome)),
      SnapshotBegin: () => replica.beginSnapshot(body(SnapshotBegin)),
      SnapshotChunk: () => replica.addChunk(body(SnapshotChunk)),
      SnapshotEnd: () => replica.endSnapshot(body(SnapshotEnd)),
      SurfaceDelta: () => replica.apply(body(SurfaceDelta)),
    }[kinds[message.bodyType()]];
    if (take?.())
      states.push({
        revision: Number(replica.revision),
        hash: hex(replica.surface.surfaceHash),
        agrees: replica.agrees,
      });
  }
  return { replica, asked, states };
}
const { Body } = await load("wire/incise/wire/body");
const kinds = Object.fromEntries(
  Object.entries(Body)
    .filter(([, n]) => typeof n === "number")
    .map(([name, n]) => [n, name]),
);
const kindOf = (bytes) => kinds[Message.getRootAsMessage(new ByteBuffer(bytes)).bodyType()];

test("a replica goes through the protocol's example and agrees with every hash", () => {
  const { states, asked, replica } = follow(surfaceStream());
  assert.deepEqual(
    states,
    json("streams/surface.json").map(({ revision, hash }) => ({ revision, hash, agrees: true })),
  );
  assert.ok(states.length >= 3);
  assert.deepEqual(asked, []);
  assert.ok(replica.stateHash !== 0n && replica.session !== 0n);
});

test("a flipped bit in a position is seen, the state is asked for, and deltas are passed over until it comes", () => {
  const messages = surfaceStream();
  const delta = messages.findIndex((bytes) => kindOf(bytes) === "SurfaceDelta");
  const { states, asked, replica } = follow(messages, (i, bytes) => {
    if (i !== delta) return;
    const positions = Message.getRootAsMessage(new ByteBuffer(bytes))
      .body(new SurfaceDelta())
      .vertices()
      .positionsArray();
    positions[0] += 1;
  });
  assert.equal(states[0].agrees, true);
  assert.equal(states[1].agrees, false);
  assert.equal(states.length, 2); // the next delta was not applied
  assert.deepEqual(asked, ["the surface hash differs"]);
  assert.equal(replica.agrees, false);
});

test("a snapshot ends the wait for the state", () => {
  const messages = surfaceStream();
  const kindsSent = messages.map(kindOf);
  const begin = kindsSent.indexOf("SnapshotBegin"),
    end = kindsSent.indexOf("SnapshotEnd"),
    delta = kindsSent.indexOf("SurfaceDelta");
  // The second delta does not follow on the snapshot; the snapshot and the first one do.
  const { states, asked } = follow([
    ...messages.slice(0, end + 1),
    messages[delta + 1],
    ...messages.slice(begin, end + 1),
    messages[delta],
  ]);
  assert.deepEqual(asked, ["the delta does not follow on the state"]);
  assert.deepEqual(
    states.map((s) => [s.revision, s.agrees]),
    [
      [0, true],
      [0, true],
      [1, true],
    ],
  );
});

test("a delta before any snapshot, and one of another session, is passed over", () => {
  const messages = surfaceStream();
  const delta = messages.findIndex((bytes) => kindOf(bytes) === "SurfaceDelta");
  assert.deepEqual(follow([messages[0], messages[delta]]).states, []);
  const { replica } = follow(messages);
  assert.equal(replica.holding, true);
  replica.distrust();
  assert.equal(replica.holding, false);
});

test("a welcome to the session that is held keeps its state, and drops a snapshot that was cut off", () => {
  const messages = surfaceStream();
  const [begin, end, delta] = ["SnapshotBegin", "SnapshotEnd", "SurfaceDelta"].map((kind) =>
    messages.findIndex((bytes) => kindOf(bytes) === kind),
  );
  const held = messages.slice(0, end + 1);
  for (const cut of [[], [messages[begin]]]) {
    const { states, asked } = follow([...held, ...cut, messages[0], messages[delta]]);
    assert.deepEqual([states.map((s) => s.revision), asked], [[0, 1], []]);
  }
});

test("a chunk whose arrays do not fit spoils the snapshot, whatever comes after it", () => {
  const messages = surfaceStream();
  const end = messages.findIndex((bytes) => kindOf(bytes) === "SnapshotEnd");
  const { replica, asked } = follow(messages.slice(0, end));
  const chunks = [{ surfaceVertices: () => ({ idsArray: () => Uint32Array.of(0), positionsArray: () => null }) }, {}];
  for (const chunk of chunks)
    replica.addChunk({ surfaceVertices: () => null, surfaceRest: () => null, triangles: () => null, ...chunk });
  const message = Message.getRootAsMessage(new ByteBuffer(messages[end]));
  replica.endSnapshot(message.body(new SnapshotEnd()));
  assert.deepEqual(asked, ["the arrays do not fit the state"]);
});

test("elements are coloured by their smallest dihedral angle", () => {
  const elements = new Elements();
  const regular = [1, 1, 1, -1, -1, 1, -1, 1, -1, 1, -1, -1];
  const tets = { idsArray: () => Uint32Array.of(0), verticesArray: () => Uint32Array.of(0, 1, 2, 3) };
  const chunk = (positions) => ({
    firstVertex: () => 0,
    positionsArray: () => Float64Array.from(positions),
    tets: () => tets,
  });
  elements.addChunk(chunk(regular));
  assert.equal(elements.quality[0], 255); // 70.5 degrees
  const corner = [0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0.2];
  const delta = (moved, positions) => ({
    movedIdsArray: () => Uint32Array.from(moved),
    movedPositionsArray: () => Float64Array.from(positions),
    firstAdded: () => 4,
    addedPositionsArray: () => null,
    tets: () => null,
    removedTetsArray: () => null,
  });
  elements.apply(delta([0, 1, 2, 3], corner));
  // Between the floor and the slanted face: tan = 0.2 / distance of the floor's hypotenuse from its corner.
  const angle = (Math.atan(0.2 * Math.SQRT2) * 180) / Math.PI;
  assert.equal(elements.quality[0], Math.round((255 * angle) / 45));
  // Whichever of its vertices moves, a tetrahedron is measured again.
  for (let v = 0; v < 4; ++v) {
    elements.apply(delta([0, 1, 2, 3], regular));
    assert.equal(elements.quality[0], 255);
    const flat = [0, 1, 2].map(
      (k) => (regular[k] + regular[3 + k] + regular[6 + k] + regular[9 + k] - regular[3 * v + k]) / 3,
    );
    elements.apply(delta([v], flat));
    assert.equal(elements.quality[0], 0, `vertex ${v}`);
  }
});
