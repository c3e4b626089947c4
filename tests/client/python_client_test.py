"""The Python client against the protocol's golden vectors, and against a server that is played from them.

Run with client/python and the build's python directory on PYTHONPATH; INCISE_SOURCE_DIR names the source tree.
"""

import contextlib
import json
import os
import pathlib
import socket
import struct
import subprocess
import sys
import threading
import unittest

import flatbuffers
import numpy as np

import incise_client
from incise.wire import (BladeLoad, Body, Delta, Error, ErrorCode, Force, Hello, LocalContact, Message, Ping, Pong, PoseBatch, Positions, Recording, Role,
                         SnapshotBegin, SnapshotChunk, SnapshotEnd, SurfaceDelta, Undo, Vec3, View)

VECTORS = pathlib.Path(os.environ["INCISE_SOURCE_DIR"]) / "protocol" / "vectors"


def split(stream):
    """The messages of a TCP stream."""
    while stream:
        (size,) = struct.unpack_from("<I", stream)
        yield bytes(stream[4:4 + size])
        stream = stream[4 + size:]


def parse(data):
    message = Message.Message.GetRootAs(data, 0)
    kinds = {Body.Body.SnapshotBegin: SnapshotBegin.SnapshotBegin, Body.Body.SnapshotChunk: SnapshotChunk.SnapshotChunk,
             Body.Body.SnapshotEnd: SnapshotEnd.SnapshotEnd, Body.Body.Delta: Delta.Delta, Body.Body.Hello: Hello.Hello,
             Body.Body.Force: Force.Force, Body.Body.SurfaceDelta: SurfaceDelta.SurfaceDelta}
    table = kinds.get(message.BodyType())
    if not table:
        return None
    body = table()
    body.Init(message.Body().Bytes, message.Body().Pos)
    return body


class Module(unittest.TestCase):
    def test_what_is_missing_is_named(self):
        for name in ("numpy", "flatbuffers"):
            done = subprocess.run([sys.executable, "-c", f"import sys; sys.modules[{name!r}] = None; import incise_client"],
                                  capture_output=True, text=True, check=False)
            self.assertEqual(done.returncode, 1)
            self.assertIn(f"ModuleNotFoundError: incise_client needs NumPy and flatbuffers, and {name} is missing: pip install", done.stderr)
            self.assertNotIn("During handling", done.stderr)

    def test_all_that_is_named_is_there(self):
        for name in incise_client.__all__:
            self.assertTrue(hasattr(incise_client, name), name)
        self.assertIn("incise_client.POSE_DTYPE", incise_client.Client.send_pose_array.__doc__)
        self.assertEqual(incise_client.POSE_DTYPE.itemsize, 72)


class Hashes(unittest.TestCase):
    def test_the_examples_of_the_specification(self):
        vertex = incise_client.vertex_hashes(np.array([1], np.uint32), np.array([[0.01, -0.02, 0.03]]))
        self.assertEqual(int(vertex[0]), 0xDA475B55C0D64116)
        tet = incise_client.tet_hashes(np.array([7], np.uint32), np.array([[3, 2, 1, 0]], np.uint32),
                                       np.array([-5], np.int32), np.array([9], np.uint8))
        self.assertEqual(int(tet[0]), 0x849A8E5067505862)

    def test_nothing_hashes_to_zero(self):
        self.assertEqual(incise_client.Replica().compute_state_hash(), 0)


class Contact(unittest.TestCase):
    """The golden Force: a plane at z = 0.03 of 800 N/m, 2.5 N s/m, that gives way at 0.75 N, for 20 ms."""

    def setUp(self):
        self.force = parse((VECTORS / "messages" / "Force.bin").read_bytes())
        self.renderer = incise_client.ContactRenderer(ramp_s=0.1)
        self.now = 1_000_000_000

    def at(self, z, fresh=True):
        self.now += 1_000_000
        if fresh:
            self.renderer.take(self.force, self.now)
        return self.renderer.force((0.0, 0.0, z), self.now)

    def test_a_spring_that_gives_way_and_expires(self):
        for i in range(200):
            force = self.at(0.031 - 1e-5 * i)
        self.assertAlmostEqual(force[2], 0.75 + (2.5 + 0.125) * 0.01, delta=0.002)  # at 0.01 m/s
        for _ in range(19):
            force = self.at(0.029, fresh=False)
        self.assertGreater(force[2], 0.5)
        for _ in range(12):
            force = self.at(0.029, fresh=False)
        self.assertEqual(float(np.abs(force).max()), 0.0)
        # It acted when it expired, so the next plane's force begins from nothing.
        self.assertLess(self.at(0.029)[2], 0.02)
        for _ in range(200):
            force = self.at(0.029)
        self.assertGreater(force[2], 0.7)

    def test_never_beyond_the_limits(self):
        last = np.zeros(3)
        for i in range(500):
            force = self.at(float("nan") if i % 50 == 7 else 0.03 * (-1) ** i)
            self.assertTrue(np.isfinite(force).all())
            self.assertLessEqual(float(np.linalg.norm(force)), 3.3 + 1e-9)
            self.assertLessEqual(float(np.linalg.norm(force - last)), 0.5 + 0.04)
            last = force


    def test_after_a_silence_of_its_own_the_ramp_begins_again(self):
        for i in range(300):
            force = self.at(0.031 - 1e-5 * min(i, 150))
        self.assertGreater(force[2], 0.35)
        for pause in (incise_client.contact.SILENCE_NS + 1, 3_000_000_000):
            self.now += pause - 1_000_000
            self.assertEqual(float(np.abs(self.at(0.0295)).max()), 0.0)
            self.assertLess(self.at(0.0295)[2], 0.01)
            for _ in range(200):
                force = self.at(0.0295)
            self.assertGreater(force[2], 0.35)
        self.now += incise_client.contact.SILENCE_NS - 1_000_000  # a shorter pause: it goes on
        self.assertGreater(self.at(0.0295)[2], 0.35)

    def test_impossible_limits_and_shapes_are_refused(self):
        for name in ("most_n", "ramp_s", "stiffest_n_m", "most_torque_n_m", "slew_n_s"):
            for bad in (float("nan"), float("inf"), -1.0):
                with self.assertRaisesRegex(ValueError, f"{name} is {bad:g}; accepted are finite numbers"):
                    incise_client.ContactRenderer(**{name: bad})
        with self.assertRaisesRegex(ValueError, "tool_m has shape"):
            self.renderer.force((0.0, 0.0), self.now)
        with self.assertRaisesRegex(ValueError, "orientation has shape"):
            self.renderer.wrench((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), self.now)

    def test_what_it_returns_is_the_callers(self):
        for i in range(200):
            force = self.at(0.031 - 1e-5 * i)
        kept = force.copy()
        force[:] = 1e9
        self.assertLess(float(np.linalg.norm(self.at(0.029) - kept)), 0.5)


def golden_force(plane):
    """The message of a line of contact.json."""
    builder = flatbuffers.Builder(0)
    contact = None
    if plane is not None:
        LocalContact.Start(builder)
        for name, value in plane.items():
            if isinstance(value, list):
                value = Vec3.CreateVec3(builder, *value)
            getattr(LocalContact, "Add" + "".join(part.capitalize() for part in name.split("_")))(builder, value)
        contact = LocalContact.End(builder)
    Force.Start(builder)
    Force.AddForceN(builder, Vec3.CreateVec3(builder, 0, 0, 0))
    if contact is not None:
        Force.AddContact(builder, contact)
    builder.Finish(Force.End(builder))
    return Force.Force.GetRootAs(builder.Output(), 0)


class ContactVectors(unittest.TestCase):
    def test_the_golden_figures(self):
        for run in json.loads((VECTORS / "contact.json").read_text()):
            renderer = incise_client.ContactRenderer(**run["limits"])
            for call in run["calls"]:
                if "take" in call:
                    renderer.take(golden_force(call["contact"]), call["take"])
                    continue
                tool = call["tool"] or [float("nan"), 0.0, 0.0]
                if run["torque"]:
                    force, torque = renderer.wrench(tool, call["turned"] or [float("nan"), 0.0, 0.0, 0.0], call["call"])
                    self.assertLess(float(np.linalg.norm(torque - call["torque"])), 1e-9, call)
                else:
                    force = renderer.force(tool, call["call"])
                self.assertLess(float(np.linalg.norm(force - call["force"])), 1e-9, call)


class Vectors(unittest.TestCase):
    """The golden stream: a snapshot, then deltas; canonical bytes after each."""

    def setUp(self):
        self.messages = list(split((VECTORS / "streams" / "volume.bin").read_bytes()))
        self.expected = json.loads((VECTORS / "streams" / "volume.json").read_text())

    def states(self):
        replica, begin, chunks = None, None, []
        for body in map(parse, self.messages):
            if isinstance(body, SnapshotBegin.SnapshotBegin):
                begin, chunks = body, []
            elif isinstance(body, SnapshotChunk.SnapshotChunk):
                chunks.append(body)
            elif isinstance(body, SnapshotEnd.SnapshotEnd):
                replica = incise_client.Replica.from_snapshot(begin, chunks, body)
                yield replica
            elif isinstance(body, Delta.Delta):
                replica.apply(body)
                yield replica

    def test_every_state_is_the_expected_one(self):
        count = 0
        for replica, expected in zip(self.states(), self.expected):
            self.assertEqual(replica.revision, expected["revision"])
            self.assertEqual(f"{replica.state_hash:016x}", expected["hash"])
            self.assertEqual(replica.compute_state_hash(), replica.state_hash)
            self.assertEqual(replica.canonical_bytes().hex(), expected["canonical_bytes"])
            self.assertEqual(len(replica.boundary_triangles()), int(sum(bin(m).count("1") for m in replica.boundary_masks)))
            count += 1
        self.assertEqual(count, len(self.expected))
        self.assertGreaterEqual(count, 3)

    def test_a_delta_of_another_base_changes_nothing(self):
        replica = next(self.states())
        before = replica.canonical_bytes()
        deltas = [b for b in map(parse, self.messages) if isinstance(b, Delta.Delta)]
        with self.assertRaises(incise_client.ApplyError):
            replica.apply(deltas[1])
        self.assertEqual(replica.canonical_bytes(), before)

    def test_a_state_that_is_wrong_is_found_by_its_hash(self):
        replica = next(self.states())
        deltas = [b for b in map(parse, self.messages) if isinstance(b, Delta.Delta)]
        replica.state_hash ^= 1
        before = replica.canonical_bytes()
        with self.assertRaises(incise_client.ApplyError):
            replica.apply(deltas[0])
        self.assertEqual(replica.canonical_bytes(), before)


class Parts(unittest.TestCase):
    """The golden streams of the surface, and of the volume in a box."""

    def follow(self, name, kind):
        replica, begin, chunks = kind(), None, []
        expected = json.loads((VECTORS / "streams" / f"{name}.json").read_text())
        for body in map(parse, split((VECTORS / "streams" / f"{name}.bin").read_bytes())):
            if isinstance(body, SnapshotBegin.SnapshotBegin):
                begin, chunks = body, []
            elif isinstance(body, SnapshotChunk.SnapshotChunk):
                chunks.append(body)
            elif isinstance(body, SnapshotEnd.SnapshotEnd):
                replica = kind.from_snapshot(begin, chunks, body)
            elif isinstance(body, (Delta.Delta, SurfaceDelta.SurfaceDelta)):
                before = replica.canonical_bytes()
                replica.hash ^= 1  # a state that is wrong is found by its hash
                with self.assertRaises(incise_client.ApplyError):
                    replica.apply(body)
                replica.hash ^= 1
                self.assertEqual(replica.canonical_bytes(), before)
                replica.apply(body)
            else:
                continue
            if isinstance(body, (SnapshotBegin.SnapshotBegin, SnapshotChunk.SnapshotChunk)):
                continue
            state = expected.pop(0)
            self.assertEqual((replica.revision, f"{replica.hash:016x}"), (state["revision"], state["hash"]))
            self.assertEqual(replica.compute_hash(), replica.hash)
            self.assertEqual(replica.canonical_bytes().hex(), state["canonical_bytes"])
        self.assertEqual(expected, [])

    def test_the_surface(self):
        self.follow("surface", incise_client.Surface)

    def test_the_volume_in_a_box(self):
        self.follow("volume_part", incise_client.VolumePart)


class Textures(unittest.TestCase):
    """The surface that a body was filled from."""

    def setUp(self):
        self.asset = incise_client.SurfaceAsset.from_bytes((VECTORS / "messages" / "SurfaceAsset.bin").read_bytes())

    def test_what_it_holds(self):
        self.assertEqual(self.asset.uvs.shape, (3, 3, 2))
        self.assertEqual(self.asset.colours.dtype, np.uint8)
        self.assertEqual([m.Name() for m in self.asset.materials], [b"capsule", b"liver"])
        self.assertEqual(self.asset.material_of.tolist(), [1, 1, 0])
        for bad in (b"", b"x" * 100, (VECTORS / "messages" / "Ping.bin").read_bytes()):
            self.assertRaises(ValueError, incise_client.SurfaceAsset.from_bytes, bad)
        self.assertRaises(ValueError, incise_client.SurfaceAsset, np.zeros((3, 3)), [[0, 1, 3]])

    def test_texture_coordinates_of_faces(self):
        faces = json.loads((VECTORS / "surface_lookup.json").read_text())
        surface = incise_client.Surface()
        n = len(faces)
        rest = np.array([f["rest"] for f in faces], np.float32).reshape(-1, 3)
        surface.vertices = incise_client.Rows(np.arange(3 * n), positions=rest + 1, rest=rest)
        surface.elements = incise_client.Rows(np.arange(n), corners=np.arange(3 * n, dtype=np.uint32).reshape(-1, 3),
                                              origins=np.array([f["origin"] for f in faces], np.uint32))
        uvs = self.asset.corner_uvs(surface)
        for face, found in zip(faces, uvs):
            if face["uvs"] is None:
                self.assertTrue(np.isnan(found).all(), face["what"])
            else:
                np.testing.assert_allclose(found, face["uvs"], atol=1e-5, err_msg=face["what"])
        self.assertEqual(self.asset.at_corners(self.asset.colours, surface).shape, (n, 3, 4))
        self.assertRaises(ValueError, incise_client.SurfaceAsset(self.asset.positions, self.asset.triangles).corner_uvs, surface)


class Session(unittest.TestCase):
    """A client against a server that says what the vectors say."""

    def serve(self, stream, *later):
        listener = socket.create_server(("127.0.0.1", 0))
        self.received = []

        def run():
            peer, _ = listener.accept()
            with peer, contextlib.suppress(ConnectionError):  # a client may close before it has read all
                (size,) = struct.unpack("<I", peer.recv(4, socket.MSG_WAITALL))
                self.received.append(peer.recv(size, socket.MSG_WAITALL))
                for i in range(0, len(stream), 7):  # in bits that end anywhere
                    peer.sendall(stream[i:i + 7])
                for when, more in later:
                    when.wait(20)
                    peer.sendall(more)
                while True:
                    head = peer.recv(4, socket.MSG_WAITALL)
                    if len(head) < 4:
                        return
                    self.received.append(peer.recv(struct.unpack("<I", head)[0], socket.MSG_WAITALL))

        self.thread = threading.Thread(target=run)
        self.thread.start()
        self.addCleanup(listener.close)
        return listener.getsockname()[1]

    def test_holds_the_replica_and_sends_poses(self):
        stream = (VECTORS / "streams" / "volume.bin").read_bytes()
        expected = json.loads((VECTORS / "streams" / "volume.json").read_text())
        last = len(stream)
        bodies = list(split(stream))
        last -= 4 + len(bodies[-1])  # without the Bye
        port = self.serve(stream[:last])
        with incise_client.connect("127.0.0.1", port, role=Role.Role.Operator, source_name="left") as client:
            self.assertTrue(client.wait_for_revision(expected[-1]["revision"]))
            self.assertEqual(client.replica.canonical_bytes().hex(), expected[-1]["canonical_bytes"])
            self.assertEqual(client.resyncs, 0)
            client.send_poses([incise_client.Pose(5, (1.0, 2.0, 3.0), buttons=1), incise_client.Pose(6, (4.0, 5.0, 6.0))])
        self.thread.join()
        hello = parse(self.received[0])
        self.assertEqual((hello.ProtocolVersion(), hello.Role(), hello.SourceName()), (2, Role.Role.Operator, b"left"))
        self.assertIn(struct.pack("<q7dII", 5, 1, 2, 3, 1, 0, 0, 0, 1, 0), self.received[1])
        self.assertEqual(Message.Message.GetRootAs(self.received[1], 0).Sequence(), 2)
        self.assertEqual(Message.Message.GetRootAs(self.received[-1], 0).BodyType(), Body.Body.Bye)

    def test_roles_and_views_have_names(self):
        for role, view in ((Role.Role.Operator, View.View.Surface), ("operator", "surface")):
            port = self.serve(self.messages("Welcome"))
            incise_client.connect("127.0.0.1", port, role=role, view=view).close()
            self.thread.join()
            hello = parse(self.received[0])
            self.assertEqual((hello.Role(), hello.View()), (Role.Role.Operator, View.View.Surface))
        for options, text in (({"view": "whole"}, 'view: found \'whole\'; accepted is "none", "surface", "volume", or a wire.View'),
                              ({"role": 9}, 'role: found 9; accepted is "viewer", "operator", "simulator", "admin", or a wire.Role')):
            with self.subTest(text), self.assertRaises(ValueError) as raised:
                incise_client.connect("127.0.0.1", 1, **options)
            self.assertEqual(str(raised.exception), text)

    def test_reset_and_undo_are_sent(self):
        port = self.serve(self.messages("Welcome"))
        with incise_client.connect("127.0.0.1", port, role=Role.Role.Admin) as client:
            client.reset()
            client.undo()
            client.undo(others=True)
        self.thread.join()
        messages = [Message.Message.GetRootAs(data, 0) for data in self.received]
        self.assertEqual([message.BodyType() for message in messages if message.BodyType()],
                         [Body.Body.Hello, Body.Body.Reset, Body.Body.Undo, Body.Body.Undo, Body.Body.Bye])
        undos = [Undo.Undo() for message in messages if message.BodyType() == Body.Body.Undo]
        for undo, message in zip(undos, [message for message in messages if message.BodyType() == Body.Body.Undo]):
            undo.Init(message.Body().Bytes, message.Body().Pos)
        self.assertEqual([undo.Others() for undo in undos], [False, True])

    def test_after_an_undo_it_waits_for_the_state_of_the_new_session(self):
        volume = [struct.pack("<I", len(body)) + body for body in split((VECTORS / "streams" / "volume.bin").read_bytes())]
        kinds = [Message.Message.GetRootAs(data, 4).BodyType() for data in volume]
        ended = kinds.index(Body.Body.SnapshotEnd) + 1
        self.assertEqual(kinds[0], Body.Body.Welcome)
        undone, sent = threading.Event(), threading.Event()
        port = self.serve(b"".join(volume[:ended]), (undone, volume[0]), (sent, b"".join(volume[1:ended])))
        with incise_client.connect("127.0.0.1", port, role=Role.Role.Simulator) as client:
            self.assertTrue(client.wait_for_revision(0))
            before, welcome = client.replica, client.welcome
            undone.set()
            while client.welcome is welcome:
                client.poll(0.01)
            self.assertFalse(client.snapshots_or_resumed)
            self.assertFalse(client.wait_for_revision(0, 0.2))
            with self.assertRaisesRegex(ValueError, r"no state of the body has come yet.*wait_for_revision\(0\)"):
                client.send_positions(before.positions)
            sent.set()
            self.assertTrue(client.wait_for_revision(0))
            self.assertEqual(client.replica.canonical_bytes(), before.canonical_bytes())
            self.assertIsNot(client.replica, before)
            client.send_positions(client.replica.positions)
        self.thread.join()

    def messages(self, *names):
        bodies = [(VECTORS / "messages" / f"{name}.bin").read_bytes() for name in names]
        return b"".join(struct.pack("<I", len(body)) + body for body in bodies)

    def sent(self, kind, module):
        """The messages of that kind that the server has received."""
        found = []
        for data in self.received:
            message = Message.Message.GetRootAs(data, 0)
            if message.BodyType() == kind:
                body = module()
                body.Init(message.Body().Bytes, message.Body().Pos)
                found.append(body)
        return found

    def test_the_greeting_has_all_that_was_asked_for(self):
        port = self.serve(self.messages("Welcome"))
        asked = {"role": Role.Role.Operator, "view": View.View.Surface, "token": "secret", "source_name": "left",
                 "take_over": True, "blade": ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0)), "max_rate_hz": 12.5}
        with incise_client.connect("127.0.0.1", port, **asked):
            pass
        self.thread.join()
        hello = parse(self.received[0])
        self.assertEqual((hello.Role(), hello.View(), hello.Token()), (Role.Role.Operator, View.View.Surface, b"secret"))
        self.assertEqual((hello.SourceName(), hello.TakeOver(), hello.MaxRateHz()), (b"left", True, 12.5))
        self.assertEqual((hello.Blade().Heel().Y(), hello.Blade().Tip().X()), (2.0, 4.0))
        self.assertEqual((hello.ResumeSession(), hello.ResumeRevision(), hello.ResumeHash(), hello.Box()), (0, 0, 0, None))

    def test_answers_a_ping_with_its_number_and_time(self):
        port = self.serve(self.messages("Welcome", "Ping"))
        with incise_client.connect("127.0.0.1", port) as client:
            while len(self.received) < 2:
                client.poll(0.1)
        self.thread.join()
        ping = Ping.Ping()
        message = Message.Message.GetRootAs((VECTORS / "messages" / "Ping.bin").read_bytes(), 0)
        ping.Init(message.Body().Bytes, message.Body().Pos)
        (pong,) = self.sent(Body.Body.Pong, Pong.Pong)
        self.assertNotEqual(ping.Nonce(), ping.SentNs())
        self.assertEqual((pong.Nonce(), pong.PingSentNs()), (ping.Nonce(), ping.SentNs()))

    def test_many_poses_are_sent_in_several_messages_and_none_is_lost(self):
        port = self.serve(self.messages("Welcome"))
        poses = np.zeros(2 * incise_client.client.MAX_POSES_PER_BATCH + 100, incise_client.client.POSE_DTYPE)
        poses["source_ns"] = np.arange(1, len(poses) + 1)
        with incise_client.connect("127.0.0.1", port, role=Role.Role.Operator) as client:
            self.assertEqual(client.send_pose_array(poses), 4)
        self.thread.join()
        batches = self.sent(Body.Body.PoseBatch, PoseBatch.PoseBatch)
        most = incise_client.client.MAX_POSES_PER_BATCH
        self.assertEqual([batch.PosesLength() for batch in batches], [most, most, 100])
        times = [batch.Poses(i).SourceNs() for batch in batches for i in (0, batch.PosesLength() - 1)]
        self.assertEqual(times, [1, most, most + 1, 2 * most, 2 * most + 1, len(poses)])

    def test_positions_say_which_vertices_they_are_of(self):
        port = self.serve(self.messages("Welcome"))
        with incise_client.connect("127.0.0.1", port, role=Role.Role.Simulator) as client:
            client.send_positions(np.zeros((2, 3), np.float32), first=7, revision=5)
            client.send_positions(np.ones((2, 3)), ids=[3, 9], revision=0)
            for positions, ids, text in ((np.ones((3, 2)), None, r"found shape \(3, 2\)"), (np.ones(6), None, r"accepted is \(n, 3\)"),
                                         (np.ones((1, 3), complex), None, "complex128"), (np.ones((1, 3)), [-1], "ids: "),
                                         (np.ones((1, 3)), [2**32], "ids: "), (np.ones((1, 3)), [1.5], "ids: found .* float64"),
                                         (np.ones((1, 3)), [1, 2], r"accepted is \(1,\)"),
                                         (np.ones((2, 3)), [2, 1], "ids: number 1 is 1 after 2; accepted are ascending ids"),
                                         (np.ones((3, 3)), np.array([0, 5, 5], np.uint64), "ids: number 2 is 5 after 5"),
                                         (np.ma.masked_equal(np.eye(3), 1), None, "masked numbers")):
                with self.subTest(text), self.assertRaisesRegex(ValueError, text):
                    client.send_positions(positions, ids=ids)
        self.thread.join()
        some, others = self.sent(Body.Body.Positions, Positions.Positions)
        self.assertEqual((some.Frame(), some.First(), some.Revision()), (1, 7, 5))
        self.assertEqual((some.F32Length(), some.F64Length(), some.IdsLength()), (6, 0, 0))
        self.assertEqual((others.Frame(), others.First(), others.Revision()), (2, 0, 0))
        self.assertEqual((others.F32Length(), others.F64Length()), (0, 6))
        self.assertEqual(list(others.IdsAsNumpy()), [3, 9])

    def test_positions_of_vertices_that_the_body_does_not_have_are_not_sent(self):
        stream = (VECTORS / "streams" / "volume.bin").read_bytes()
        port = self.serve(stream[:-4 - len(list(split(stream))[-1])])  # without the Bye
        with incise_client.connect("127.0.0.1", port, role=Role.Role.Simulator) as client:
            self.assertTrue(client.wait_for_revision(2))
            n = len(client.replica.positions)
            for options, text in (({"ids": [0, n]}, f"ids: vertex {n}; accepted are those below {n}"),
                                  ({"first": n - 1}, f"first: vertex {n}; accepted are those below {n}"),
                                  ({"first": -1}, "first: vertices -1 to 0; accepted are whole numbers of 32 bits"),
                                  ({"ids": [0, n], "revision": 1}, f"ids: vertex {n}")):
                with self.subTest(text), self.assertRaisesRegex(ValueError, text):
                    client.send_positions(np.ones((2, 3)), **options)
            client.send_positions(np.ones((2, 3)), ids=[0, n - 1])
            client.send_positions(np.ones((2, 3)), first=n - 2)
        self.thread.join()
        self.assertEqual(len(self.sent(Body.Body.Positions, Positions.Positions)), 2)

    def test_a_closed_client_says_so(self):
        stream = (VECTORS / "streams" / "volume.bin").read_bytes()
        port = self.serve(stream[:4 + len(next(split(stream)))])  # the Welcome alone: what is left unread would reset the connection, and the Bye with it
        with incise_client.connect("127.0.0.1", port) as client:
            client.close()
            client.close()
            for use in (client.poll, client.engage, client.end_stroke, client.undo, lambda: client.wait_for_revision(0),
                        lambda: client.wait_for_report(1), lambda: client.send_poses([]), lambda: client.send_poses([incise_client.Pose(1, (0.0, 0.0, 0.0))]),
                        lambda: client.send_positions(np.ones((1, 3)), revision=0), lambda: client.wait_for_positions_report(1),
                        lambda: client.send_model(BladeLoad.BladeLoad(), (0, 0, 0), (0, 0, 1), np.eye(3))):
                with self.assertRaisesRegex(incise_client.ConnectError, "this client is closed"):
                    use()
        self.thread.join()
        self.assertEqual([Message.Message.GetRootAs(data, 0).BodyType() for data in self.received if data][-1], Body.Body.Bye)

    def test_a_callback_may_close_the_client(self):
        stream = (VECTORS / "streams" / "volume.bin").read_bytes()
        for wait in (lambda client: client.wait_for_revision(1), lambda client: [client.poll(1.0) for _ in range(1000) if not client.replica.revision]):
            closed_at = []

            def close(client, delta):
                closed_at.append(client.replica.revision)
                client.close()

            with incise_client.connect("127.0.0.1", self.serve(stream)) as client:
                client.on_delta = close
                wait(client)
                self.assertEqual((closed_at, client.replica.revision), ([1], 1))
                self.assertRaisesRegex(incise_client.ConnectError, "closed", client.poll)
            self.thread.join()

    def test_a_port_that_speaks_http_is_called_that(self):
        port = self.serve(b"HTTP/1.1 400 Bad Request\r\n\r\n")
        with self.assertRaisesRegex(incise_client.ConnectError, f"^127.0.0.1:{port}: the port speaks HTTP, .* use the other port"):
            incise_client.connect("127.0.0.1", port)
        self.thread.join()

    def test_numbers_that_are_none_are_not_sent(self):
        port = self.serve(self.messages("Welcome"))
        nan = float("nan")
        with incise_client.connect("127.0.0.1", port, role=Role.Role.Operator) as client:
            good = incise_client.Pose(1, (0.0, 0.0, 0.0))
            with self.assertRaisesRegex(ValueError, r"poses: number 1 has position \[ 0. nan  0.\]"):
                client.send_poses([good, incise_client.Pose(2, (0.0, nan, 0.0))])
            with self.assertRaisesRegex(ValueError, "poses: number 0 .* accepted are finite numbers"):
                client.send_poses([incise_client.Pose(2, (0.0, 0.0, 0.0), (float("inf"), 0.0, 0.0, 0.0)), good])
            for bad in (nan, 1.1e6):
                with self.assertRaisesRegex(ValueError, "positions: row 1 is "):
                    client.send_positions([[0, 0, 0], [0, 0, bad]])
            load = BladeLoad.BladeLoad()
            with self.assertRaisesRegex(ValueError, "point, normal, .* accepted are finite numbers"):
                client.send_model(load, (nan, 0, 0), (0, 0, 1), np.eye(3))
            with self.assertRaisesRegex(ValueError, r"point, normal: found \(0, 0, 0\), \(0, 0\); accepted are three numbers each"):
                client.send_model(load, (0, 0, 0), (0, 0), np.eye(3))
            for bad in (0, -1, 1e12):
                with self.assertRaisesRegex(ValueError, "valid_s: found .*; accepted is above 0 and up to 1"):
                    client.send_model(load, (0, 0, 0), (0, 0, 1), np.eye(3), valid_s=bad)
        self.thread.join()
        kinds = [Message.Message.GetRootAs(data, 0).BodyType() for data in self.received]
        self.assertEqual([kind for kind in kinds if kind], [Body.Body.Hello, Body.Body.Bye])

    def test_a_refusal_reaches_the_callback_and_who_waits_for_it(self):
        builder = flatbuffers.Builder(0)
        text = builder.CreateString("PoseBatch: only operators send poses")
        Error.Start(builder)
        Error.AddCode(builder, ErrorCode.ErrorCode.Forbidden)
        Error.AddText(builder, text)
        Error.AddInReplyTo(builder, 2)
        body = Error.End(builder)
        Message.Start(builder)
        Message.AddBodyType(builder, Body.Body.Error)
        Message.AddBody(builder, body)
        builder.Finish(Message.End(builder), file_identifier=b"INC1")
        refusal = bytes(builder.Output())
        heard = []
        port = self.serve(self.messages("Welcome") + struct.pack("<I", len(refusal)) + refusal)
        with incise_client.connect("127.0.0.1", port) as client:
            client.on_error = lambda who, error: heard.append((who, error.Code(), error.Text(), error.InReplyTo()))
            sequence = client.send_poses([incise_client.Pose(1, (0.0, 0.0, 0.0))])
            with self.assertRaisesRegex(incise_client.RequestError, "only operators send poses") as raised:
                client.wait_for_report(sequence)
            self.assertEqual((raised.exception.code, raised.exception.sequence), (ErrorCode.ErrorCode.Forbidden, 2))
            self.assertEqual(heard, [(client, ErrorCode.ErrorCode.Forbidden, b"PoseBatch: only operators send poses", 2)])
            self.assertFalse(client.wait_for_report(sequence, 0.05), "was raised once")
        self.thread.join()

    def test_a_server_that_refuses_says_why(self):
        port = self.serve(self.messages("Error"))
        with self.assertRaisesRegex(incise_client.ConnectError, "is held by session 3") as raised:
            incise_client.connect("127.0.0.1", port)
        self.assertEqual(raised.exception.code, ErrorCode.ErrorCode.BladeTaken)
        self.thread.join()

    def test_a_server_that_is_gone_is_a_connect_error_for_who_sends(self):
        port = self.serve(self.messages("Welcome"))
        client = incise_client.connect("127.0.0.1", port, role=Role.Role.Operator)
        client._socket.shutdown(socket.SHUT_RDWR)
        with self.assertRaisesRegex(incise_client.ConnectError, "the connection has ended: "):
            client.send_poses([incise_client.Pose(1, (0.0, 0.0, 0.0))])
        client.close()
        self.thread.join()

    def test_a_length_that_no_message_has_ends_the_connection(self):
        for size in (15, (64 << 20) + 1):
            port = self.serve(self.messages("Welcome") + struct.pack("<I", size) + bytes(100))
            with self.assertRaisesRegex(incise_client.ConnectError, f"a message of {size} bytes"):
                with incise_client.connect("127.0.0.1", port) as client:
                    for _ in range(100):
                        client.poll(0.05)
            self.thread.join()

    def test_an_operator_hears_what_is_recorded(self):
        port = self.serve(self.messages("WelcomeRecording", "ErrorNotRecorded", "PoseReportRecorded"))
        with incise_client.connect("127.0.0.1", port, role=Role.Role.Operator) as client:
            self.assertEqual(client.welcome.Recording(), Recording.Recording.On)
            self.assertTrue(client.wait_for_report(17))
            self.assertEqual((client.error.Code(), client.error.Text()),
                             (ErrorCode.ErrorCode.NotRecorded, b"poses are cut, but not recorded: No space left on device"))
            self.assertEqual((client.report.Accepted(), client.report.Recorded()), (100, 90))
            self.assertEqual(client.report.RecordedSourceNs(), 991_000_000)
            self.assertEqual(client.recording, Recording.Recording.Stopped)
        self.thread.join()

    def test_holds_what_touches_a_box(self):
        for name, view in (("volume_part", View.View.Volume), ("surface", View.View.Surface)):
            expected = json.loads((VECTORS / "streams" / f"{name}.json").read_text())
            stream = (VECTORS / "streams" / f"{name}.bin").read_bytes()
            port = self.serve(stream[:-4 - len(list(split(stream))[-1])])  # without the Bye
            with incise_client.connect("127.0.0.1", port, view=view, box=((0, -1, -2), (1, 2, 3))) as client:
                self.assertTrue(client.wait_for_revision(expected[-1]["revision"]))
                self.assertEqual(client.replica.canonical_bytes().hex(), expected[-1]["canonical_bytes"])
                self.assertEqual(client.resyncs, 0)
            self.thread.join()
            hello = parse(self.received[0])
            self.assertEqual((hello.View(), hello.Box().Min().Z(), hello.Box().Max().Y()), (view, -2, 2))

    def test_resumes_what_another_client_held(self):
        hashes = set()
        for name, view in (("volume", View.View.Volume), ("surface", View.View.Surface)):
            stream = (VECTORS / "streams" / f"{name}.bin").read_bytes()
            stream = stream[:-4 - len(list(split(stream))[-1])]  # without the Bye
            with incise_client.connect("127.0.0.1", self.serve(stream), view=view) as first:
                self.assertTrue(first.wait_for_revision(2))
            self.thread.join()
            self.assertEqual(parse(self.received[0]).ResumeHash(), 0)
            with incise_client.connect("127.0.0.1", self.serve(stream), view=view, resume=first):
                pass
            self.thread.join()
            hello = parse(self.received[0])
            self.assertEqual((hello.ResumeSession(), hello.ResumeRevision()), (first.welcome.Session(), 2))
            hashes.add(hello.ResumeHash())
            if view == View.View.Volume:
                self.assertEqual(hello.ResumeHash(), first.replica.state_hash, "of the last delta, not of the snapshot")
        self.assertEqual(len(hashes), 1, "the whole mesh's, in either view")
        self.assertNotEqual(hashes, {0})

    def test_does_not_resume_a_state_that_was_refused(self):
        stream = (VECTORS / "streams" / "volume.bin").read_bytes()
        stream = stream[:-4 - len(list(split(stream))[-1])]  # without the Bye
        bodies = list(split(stream))
        del bodies[-2]  # so the last delta does not fit
        with incise_client.connect("127.0.0.1", self.serve(b"".join(struct.pack("<I", len(b)) + b for b in bodies))) as first:
            while not first.resyncs:
                first.poll(0.1)
        self.thread.join()
        with incise_client.connect("127.0.0.1", self.serve(stream), resume=first):
            pass
        self.thread.join()
        self.assertEqual(parse(self.received[0]).ResumeSession(), 0)

    def test_says_why_it_ends(self):
        port = self.serve((VECTORS / "streams" / "volume.bin").read_bytes())
        with self.assertRaisesRegex(incise_client.ConnectError, "the server stops"):
            with incise_client.connect("127.0.0.1", port) as client:
                client.wait_for_revision(10**6)
        self.thread.join()

    def test_nobody_there(self):
        listener = socket.create_server(("127.0.0.1", 0))
        port = listener.getsockname()[1]
        listener.close()
        with self.assertRaisesRegex(incise_client.ConnectError, str(port)):
            incise_client.connect("127.0.0.1", port)


if __name__ == "__main__":
    unittest.main()
