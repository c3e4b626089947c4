"""What the Python replicas make of changes that the golden streams do not have: a random walk beside a plain model, pieces,
rest positions, and what must be refused.

Run like python_client_test.py.
"""

import random
import unittest

import flatbuffers
import numpy as np

import incise_client
from incise.wire import (Box, Delta, SnapshotBegin, SnapshotChunk, SnapshotEnd, Step, SurfaceDelta, SurfaceVertices, Tets,
                         Triangles, Vec3)
from incise_client.part import Rows
from incise_client.replica import NO_ID


def build(b, module, fields):
    """The offset of a table; a value that is a pair (module, fields) is a table in it, a list of pairs a vector of these."""
    made = {}
    for name, value in fields.items():
        if isinstance(value, tuple):
            made[name] = build(b, *value)
        elif isinstance(value, list):
            offsets = [build(b, *one) for one in value]
            module.StartStepsVector(b, len(offsets))
            for offset in reversed(offsets):
                b.PrependUOffsetTRelative(offset)
            made[name] = b.EndVector()
        elif isinstance(value, np.ndarray):
            made[name] = b.CreateNumpyVector(value)
        else:
            made[name] = value
    module.Start(b)
    for name, value in made.items():
        getattr(module, "Add" + name)(b, value)
    return module.End(b)


def table(module, fields):
    """A table as a client reads it from a message."""
    b = flatbuffers.Builder(1024)
    b.Finish(build(b, module, fields))
    return getattr(module, module.__name__.split(".")[-1]).GetRootAs(b.Output(), 0)


def u32(values):
    return np.array(list(values), np.uint32)


class Model:
    """A state told in the plainest way: lists and dictionaries."""

    def __init__(self, seed):
        self.random = random.Random(seed)
        self.revision = 1
        self.positions = [self.place() for _ in range(6)]
        self.rest = None
        self.tets = {t: self.tet(6) for t in range(4)}
        self.slots = 4
        self.names = {}

    def place(self):
        return [self.random.uniform(-1, 1) for _ in range(3)]

    def tet(self, vertices):
        r = self.random
        return {"v": r.sample(range(vertices), 4), "region": r.randrange(-3, 4), "cut": r.randrange(16),
                "boundary": r.randrange(16)}

    def pieces(self):
        """By tetrahedron: the last piece of which what it hangs together with has the tetrahedron."""
        piece_of = {}
        for first in self.tets:
            part, vertices, grows = {first}, set(self.tets[first]["v"]), True
            while grows:
                more = {t for t in self.tets if vertices & set(self.tets[t]["v"])} - part
                part |= more
                vertices.update(v for t in more for v in self.tets[t]["v"])
                grows = bool(more)
            piece_of[first] = max((piece for piece, tet in self.names.items() if tet in part), default=0)
        return piece_of

    def hash(self):
        ids = sorted(self.tets)
        value = incise_client.state_hash.xor_of(
            incise_client.vertex_hashes(u32(range(len(self.positions))), np.array(self.positions)))
        if not ids:
            return value
        return value ^ incise_client.state_hash.xor_of(incise_client.tet_hashes(
            u32(ids), np.array([self.tets[t]["v"] for t in ids], np.uint32),
            np.array([self.tets[t]["region"] for t in ids], np.int32),
            np.array([self.tets[t]["cut"] for t in ids], np.uint8)))

    def arrays(self, ids):
        return (Tets, {"Ids": u32(ids), "Vertices": u32(v for t in ids for v in self.tets[t]["v"]),
                       "Regions": np.array([self.tets[t]["region"] for t in ids], np.int32),
                       "CutMasks": np.array([self.tets[t]["cut"] for t in ids], np.uint8),
                       "BoundaryMasks": np.array([self.tets[t]["boundary"] for t in ids], np.uint8)})

    def snapshot(self, rest=None):
        ids = sorted(self.tets)
        names = {piece: tet for piece, tet in self.names.items() if tet in self.tets}
        chunk = {"Positions": np.array(self.positions).reshape(-1), "Tets": self.arrays(ids)}
        if rest is not None:
            chunk["RestPositions"] = np.array(rest).reshape(-1)
        return (table(SnapshotBegin, {"Revision": self.revision, "Chunks": 1, "VertexCount": len(self.positions),
                                      "TetCount": len(ids), "PieceIds": u32(names), "PieceNames": u32(names.values())}),
                [table(SnapshotChunk, chunk)],
                table(SnapshotEnd, {"Revision": self.revision, "StateHash": self.hash()}))

    def replica(self):
        return incise_client.Replica.from_snapshot(*self.snapshot())

    def step(self, deforms=False):
        """A random change; the fields of the delta that says it."""
        r = self.random
        old = len(self.positions)
        before = [list(p) for p in self.positions]
        tets_before = sorted(self.tets)
        moved = sorted(r.sample(range(old), r.randrange(min(4, old))))
        for v in moved:
            self.positions[v] = self.place()
        parents = []
        for v in range(old, old + r.randrange(3)):
            parents.append((r.randrange(v), r.randrange(v), r.random()))
            self.positions.append(self.place())
        first_new = self.slots + r.randrange(3)
        gone = sorted(r.sample(sorted(self.tets), r.randrange(min(3, len(self.tets)))))
        for t in gone:
            del self.tets[t]
        changed = sorted(r.sample(sorted(self.tets), r.randrange(1 + min(3, len(self.tets)))))
        for t in changed:
            self.tets[t] = self.tet(len(self.positions))
        new = sorted(r.sample(range(first_new, first_new + 6), r.randrange(4)))
        for t in new:
            self.tets[t] = self.tet(len(self.positions))
        self.slots = max([self.slots] + [t + 1 for t in new])
        named = {r.randrange(1, 9): r.choice(sorted(self.tets))} if self.tets else {}
        self.names.update(named)
        rest_ids = []
        if deforms or self.rest is not None:
            self.rest = before if self.rest is None else self.rest
            for a, b, t in parents:
                self.rest.append([x + t * (y - x) for x, y in zip(self.rest[a], self.rest[b])])
            rest_ids = sorted(r.sample(range(len(self.positions)), 2))
            for v in rest_ids:
                self.rest[v] = self.place()
        self.revision += 1
        fields = {"BaseRevision": self.revision - 1, "Revision": self.revision,
                  "Steps": [(Step, {"Revision": self.revision, "Stroke": 0 if deforms else 1})],
                  "MovedIds": u32(moved), "MovedPositions": np.array([self.positions[v] for v in moved]).reshape(-1),
                  "FirstAdded": old, "AddedPositions": np.array(self.positions[old:]).reshape(-1),
                  "ProvenanceA": u32(p[0] for p in parents), "ProvenanceB": u32(p[1] for p in parents),
                  "ProvenanceT": np.array([p[2] for p in parents], np.float64), "Tets": self.arrays(sorted(changed + new)),
                  "RemovedTets": u32(gone), "PieceIds": u32(named), "PieceSizes": u32([1] * len(named)),
                  "PieceNames": u32(named.values()), "VertexCount": len(self.positions), "LiveTets": len(self.tets),
                  "StateHash": self.hash(), "FirstNewTet": first_new, "RestIds": u32(rest_ids)}
        blended = sorted(r.sample(range(len(self.positions)), r.randrange(4)))
        weights = [[r.uniform(-0.5, 1) for _ in range(3)] for _ in blended]
        fields |= {"BlendIds": u32(blended), "BlendVertices": u32(r.randrange(old) for _ in range(4 * len(blended))),
                   "BlendWeights": np.array([w + [1 - sum(w)] for w in weights], np.float64).reshape(-1),
                   "TetElders": u32(r.choice(tets_before) for _ in new) if tets_before else u32([])}
        if rest_ids:
            fields["RestPositions"] = np.array([self.rest[v] for v in rest_ids]).reshape(-1)
        return {name: value for name, value in fields.items() if not isinstance(value, np.ndarray) or len(value)}


def carried(step, field, tets):
    """A field on the vertices and one on the tetrahedra after a step, told in the plainest way."""
    blends = list(zip(step.get("BlendIds", []), step.get("BlendVertices", u32([])).reshape(-1, 4),
                      step.get("BlendWeights", np.empty(0)).reshape(-1, 4)))
    after = np.concatenate([field, np.zeros((len(step.get("ProvenanceT", [])),) + field.shape[1:])])
    for v, vertices, weights in blends:
        after[v] = sum(w * field[u] for u, w in zip(vertices, weights))
    for i, t in enumerate(step.get("ProvenanceT", [])):
        v = step["FirstAdded"] + i
        if v not in step.get("BlendIds", []):
            after[v] = (1 - t) * after[step["ProvenanceA"][i]] + t * after[step["ProvenanceB"][i]]
    ids = step["Tets"][1]["Ids"]
    new = ids[ids >= step["FirstNewTet"]]
    return after, tets | {int(t): tets[int(e)] for t, e in zip(new, step.get("TetElders", []))}


class Carry(unittest.TestCase):
    def test_fields_follow_the_material(self):
        for seed in range(6):
            model = Model(seed)
            r = np.random.default_rng(seed)
            field, tets = r.random((6, 2)), {t: float(t) for t in model.tets}
            got, got_tets, single = field, np.arange(float(model.slots)), field.astype(np.float32)
            for _ in range(30):
                step = model.step()
                delta = table(Delta, step)
                field, tets = carried(step, field, tets)
                got, got_tets = incise_client.carry(delta, got), incise_client.carry_tets(delta, got_tets)
                np.testing.assert_allclose(got, field, rtol=0, atol=1e-12 * np.abs(field).max())
                self.assertEqual([got_tets[t] for t in model.tets], [tets[t] for t in model.tets])
                single = incise_client.carry(delta, single)
                self.assertEqual((single.dtype, single.shape), (np.float32, field.shape))

    def test_rounds_come_one_after_the_other(self):
        for seed in range(20):
            model = Model(seed)
            r = np.random.default_rng(seed)
            field, labels = r.random(6), np.arange(6)
            steps = [model.step() for _ in range(3)]
            joined = {"FirstAdded": 6, "VertexCount": len(model.positions)}
            for name in ("AddedPositions", "ProvenanceA", "ProvenanceB", "ProvenanceT", "BlendIds", "BlendVertices", "BlendWeights"):
                parts = [step[name] for step in steps if name in step]
                joined |= {name: np.concatenate(parts)} if parts else {}
            joined["RoundAdded"] = u32(len(step.get("ProvenanceT", [])) for step in steps)
            joined["RoundBlends"] = u32(len(step.get("BlendIds", [])) for step in steps)
            delta = table(Delta, joined)
            at_once, labels_at_once = incise_client.carry(delta, field), incise_client.carry(delta, labels)
            for step in steps:
                field, labels = incise_client.carry(table(Delta, step), field), incise_client.carry(table(Delta, step), labels)
            np.testing.assert_array_equal(at_once, field)
            np.testing.assert_array_equal(labels_at_once, labels)
            self.assertTrue(set(labels.tolist()) <= set(range(6)), "labels are not interpolated")

    def test_what_does_not_fit_is_refused(self):
        good = {"FirstAdded": 4, "VertexCount": 6, "AddedPositions": np.zeros(6), "ProvenanceA": u32([0, 4]),
                "ProvenanceB": u32([1, 1]), "ProvenanceT": np.array([0.5, 0.5]), "BlendIds": u32([1, 4]),
                "BlendVertices": u32([0, 1, 2, 3] * 2), "BlendWeights": np.full(8, 0.25)}
        incise_client.carry(table(Delta, good), np.zeros(4))
        for wrong in ({"ProvenanceA": u32([0, 5])}, {"BlendIds": u32([1, 6])}, {"BlendIds": u32([4, 1])},
                      {"BlendVertices": u32([0, 1, 2, 4] * 2)}, {"BlendWeights": np.full(7, 0.25)},
                      {"RoundAdded": u32([1, 1])}, {"RoundAdded": u32([0, 2]), "RoundBlends": u32([2, 0])},
                      {"RoundAdded": u32([1, 0]), "RoundBlends": u32([1, 1])}):
            with self.subTest(wrong=wrong), self.assertRaises(ValueError):
                incise_client.carry(table(Delta, good | wrong), np.zeros(4))
        for values in (np.zeros(5), np.zeros(()), np.array(["a"] * 4)):
            with self.assertRaises(ValueError):
                incise_client.carry(table(Delta, good), values)
        tets = (Tets, {"Ids": u32([5])})
        for elders in ([5], [0, 1]):
            with self.assertRaises(ValueError):
                incise_client.carry_tets(table(Delta, {"Tets": tets, "TetElders": u32(elders)}), np.zeros(4))

    def test_a_delta_with_blends_that_do_not_fit_is_refused(self):
        model = Model(3)
        replica = model.replica()
        step = model.step()
        for wrong in ({"BlendIds": u32([99]), "BlendVertices": u32([0] * 4), "BlendWeights": np.full(4, 0.25)},
                      {"TetElders": u32([77])}):
            with self.assertRaises(incise_client.ApplyError):
                replica.apply(table(Delta, step | wrong))
        replica.apply(table(Delta, step))


class Walk(unittest.TestCase):
    def holds(self, replica, model):
        np.testing.assert_array_equal(replica.positions, model.positions)
        np.testing.assert_array_equal(replica.rest_positions, model.positions if model.rest is None else model.rest)
        self.assertEqual(list(np.flatnonzero(replica.alive)), sorted(model.tets))
        pieces = model.pieces()
        for t, tet in model.tets.items():
            self.assertEqual((list(replica.tets[t]), replica.regions[t], replica.cut_masks[t], replica.boundary_masks[t],
                              replica.pieces[t]), (tet["v"], tet["region"], tet["cut"], tet["boundary"], pieces[t]))
        gone = ~replica.alive
        self.assertTrue((replica.tets[gone] == NO_ID).all())
        for array in (replica.regions, replica.cut_masks, replica.boundary_masks, replica.pieces):
            self.assertFalse(array[gone].any())
        self.assertEqual(replica.state_hash, replica.compute_state_hash())
        self.assertEqual((replica.revision, replica.live_tets), (model.revision, len(model.tets)))

    def test_random_deltas_keep_it_in_step_with_a_plain_model(self):
        for seed in range(4):
            with self.subTest(seed=seed):
                model = Model(seed)
                replica = model.replica()
                for i in range(60):
                    replica.apply(table(Delta, model.step(deforms=i >= 20 and i % 5 == 0)))
                    self.holds(replica, model)
                late = incise_client.Replica.from_snapshot(*model.snapshot(model.rest))
                np.testing.assert_array_equal(late.rest_positions, model.rest)

    def test_rest_positions_of_some_vertices_are_none(self):
        model = Model(1)
        with self.assertRaisesRegex(incise_client.ApplyError, "rest positions"):
            incise_client.Replica.from_snapshot(*model.snapshot(model.positions[:2]))

    def test_what_does_not_fit_changes_nothing(self):
        def longer(name, value):
            return lambda f: {**f, name: np.append(f[name], np.array([value], f[name].dtype))}

        for seed in range(8):
            model = Model(seed)
            replica = model.replica()
            for _ in range(3):
                replica.apply(table(Delta, model.step()))
            before = replica.canonical_bytes()
            dead = sorted(set(range(len(replica.tets))) - set(model.tets))
            vertices = len(model.positions)
            good = model.step(deforms=True)
            cases = {"added elsewhere": lambda f: {**f, "FirstAdded": f["FirstAdded"] + 1},
                     "another count": lambda f: {**f, "VertexCount": f["VertexCount"] + 1},
                     "too many tetrahedra": lambda f: {**f, "LiveTets": f["LiveTets"] + 1},
                     "a rest position too many": longer("RestIds", 10**6),
                     "another hash": lambda f: {**f, "StateHash": f["StateHash"] ^ 1},
                     "a piece of nothing": lambda f: {**f, "PieceIds": u32([1]), "PieceNames": u32([10**6])},
                     "new among the old": lambda f: {**f, "FirstNewTet": 0}}
            if dead:
                cases["goes twice"] = lambda f: {**f, "RemovedTets": u32(dead[-1:])}
            if "Vertices" in good["Tets"][1] and len(good["Tets"][1]["Vertices"]):
                def beyond(f):
                    fields = dict(f["Tets"][1])
                    fields["Vertices"] = fields["Vertices"].copy()
                    fields["Vertices"][-1] = f["VertexCount"]
                    return {**f, "Tets": (Tets, fields)}
                cases["a vertex that is not there"] = beyond
            for what, change in cases.items():
                if what == "added elsewhere" and good["VertexCount"] == vertices:
                    continue  # nothing is added
                with self.subTest(seed=seed, what=what), self.assertRaises(incise_client.ApplyError):
                    replica.apply(table(Delta, change(good)))
                self.assertEqual(replica.canonical_bytes(), before)
            replica.apply(table(Delta, good))
            self.holds(replica, model)

    def test_faces_are_seen_from_outside(self):
        model = Model(1)
        model.positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        model.tets = {0: {"v": [0, 1, 2, 3], "region": 0, "cut": 0, "boundary": 15}}
        replica = model.replica()
        triangles = replica.positions[replica.boundary_triangles()]
        self.assertEqual(len(triangles), 4)
        for a, b, c in triangles:
            outward = np.dot(np.cross(b - a, c - a), (a + b + c) / 3 - replica.positions.mean(axis=0))
            self.assertGreater(outward, 0)


class Parts(unittest.TestCase):
    def test_an_element_is_not_removed_and_set(self):
        rows = Rows([1, 2, 3], x=np.array([10, 20, 30]))
        changed = rows.changed(Rows([2, 7], x=np.array([21, 70])), u32([3, 9]))
        self.assertEqual((list(changed.ids), list(changed.x)), ([1, 2, 7], [10, 21, 70]))
        with self.assertRaises(incise_client.ApplyError):
            rows.changed(Rows([2], x=np.array([21])), u32([2]))
        with self.assertRaisesRegex(incise_client.ApplyError, "^y: 2 entries for 3 ids$"):
            Rows([1, 2, 3], x=np.array([10, 20, 30]), y=np.array([1, 2]))

    def test_a_triangle_of_vertices_that_are_not_there_is_refused(self):
        positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
        hashes = incise_client.state_hash

        def delta(vertices):
            corners, flags = np.array([[1, 2, 3]], np.uint32), np.array([1], np.uint8)
            value = hashes.xor_of(hashes.surface_vertex_hashes(u32(vertices), positions[:len(vertices)]))
            value ^= hashes.xor_of(hashes.triangle_hashes(u32([8]), corners, flags))
            return table(SurfaceDelta, {
                "BaseRevision": 0, "Revision": 1, "SurfaceHash": value,
                "Vertices": (SurfaceVertices, {"Ids": u32(vertices), "Positions": positions[:len(vertices)].reshape(-1)}),
                "Triangles": (Triangles, {"Ids": u32([8]), "Vertices": corners.reshape(-1), "Flags": flags,
                                          "Pieces": u32([0]), "Regions": np.array([0], np.int32)})})

        surface = incise_client.Surface()
        with self.assertRaises(incise_client.ApplyError):
            surface.apply(delta([1, 2]))
        self.assertEqual((surface.revision, len(surface.vertices), len(surface.elements)), (0, 0, 0))
        surface.apply(delta([1, 2, 3]))
        self.assertEqual((surface.revision, len(surface.vertices), len(surface.elements)), (1, 3, 1))

    def test_a_tetrahedron_that_changes_stays_in_its_piece(self):
        model = Model(3)
        ids = sorted(model.tets)
        vertices = u32(range(len(model.positions)))
        begin = self.begin(model)
        chunk = table(SnapshotChunk, {"VertexIds": vertices, "Positions": np.array(model.positions).reshape(-1),
                                      "Tets": model.arrays(ids), "TetPieces": u32(7 if t == 2 else 0 for t in ids)})
        end = table(SnapshotEnd, {"Revision": 1, "StateHash": 5, "PartHash": model.hash()})
        part = incise_client.VolumePart.from_snapshot(begin, [chunk], end)
        model.tets[2]["region"] = 3
        part.apply(table(Delta, {"BaseRevision": 1, "Revision": 2, "Tets": model.arrays([2]), "FirstNewTet": model.slots,
                                 "PartHash": model.hash()}))
        at = list(part.elements.ids).index(2)
        self.assertEqual((part.elements.pieces[at], part.elements.regions[at]), (7, 3))

    @staticmethod
    def begin(model):
        b = flatbuffers.Builder(256)
        Box.Start(b)
        Box.AddMin(b, Vec3.CreateVec3(b, -1, -1, -1))
        Box.AddMax(b, Vec3.CreateVec3(b, 1, 1, 1))
        box = Box.End(b)
        SnapshotBegin.Start(b)
        for name, value in (("Revision", 1), ("Chunks", 1), ("VertexCount", len(model.positions)),
                            ("TetCount", len(model.tets)), ("Box", box)):
            getattr(SnapshotBegin, "Add" + name)(b, value)
        b.Finish(SnapshotBegin.End(b))
        return SnapshotBegin.SnapshotBegin.GetRootAs(b.Output(), 0)


if __name__ == "__main__":
    unittest.main()
