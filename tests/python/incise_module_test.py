"""The module incise against the command line, a server and bad input: incise_module_test.py BUILD.

INCISE_DATA names a folder of real meshes and motions for a further test.
"""

import ast
import copy
import ctypes
import gc
import json
import os
import pathlib
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import unittest
import warnings

import numpy as np

import incise
from incise_client.state_hash import tet_hashes, vertex_hashes, xor_of

BUILD = pathlib.Path(sys.argv.pop(1)).resolve()
SOURCE = pathlib.Path(__file__).resolve().parents[2]
BLADE = ((0, 0, 0), (0, 0, -0.12))
BLADE_TEXT = "0,0,0:0,0,-0.12"
THROUGH_SLOWLY = np.column_stack([np.linspace(0, 1, 50), np.full(50, 0.03), np.linspace(-0.1, 0.1, 50), np.full(50, 0.07)])
THROUGH = [(0, 0.03, -0.1, 0.07), (1, 0.03, 0.1, 0.07)]


class ProcessHeap(ctypes.Structure):
    """glibc's struct mallinfo2."""
    _fields_ = [(name, ctypes.c_size_t) for name in
                ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost")]


def allocated_bytes():
    """What malloc has handed out and not got back, large blocks included."""
    gc.collect()
    heap = ctypes.CDLL(None).mallinfo2
    heap.restype = ProcessHeap
    now = heap()
    return now.uordblks + now.hblkhd


def run_incise(*arguments):
    return subprocess.run([BUILD / "bin/incise", *map(str, arguments)], capture_output=True, text=True, check=False, timeout=120)


def vtk_array(path, name):
    """An array of uint32 of a VTK XML file that Incise has written."""
    xml, _, data = path.read_bytes().partition(b'<AppendedData encoding="raw">\n_')
    at = int(re.search(rf'Name="{name}"[^>]*offset="(\d+)"', xml.decode()).group(1))
    return np.frombuffer(data, "<u4", int.from_bytes(data[at:at + 8], "little") // 4, at + 8)


def glb_points(path):
    """The vertices of each node of a .glb, in the body's frame: z upwards."""
    data = path.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    gltf, binary = json.loads(data[20:20 + size]), data[28 + size:]
    out = {}
    for node in gltf["nodes"]:
        if "mesh" not in node:
            continue
        rows = []
        for primitive in gltf["meshes"][node["mesh"]]["primitives"]:
            accessor = gltf["accessors"][primitive["attributes"]["POSITION"]]
            view = gltf["bufferViews"][accessor["bufferView"]]
            rows.append(np.frombuffer(binary, "<f4", 3 * accessor["count"], view["byteOffset"]).reshape(-1, 3))
        out[node["name"]] = np.vstack(rows)
    return out


class Folder(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def cut_by_command(self, mesh, poses, *options):
        report = self.folder / "report.json"
        done = run_incise("cut", "--mesh", mesh, "--poses", poses, "--out", self.folder / "out.node", "--report", report, *options)
        self.assertIn(done.returncode, (0, 3), done.stderr)
        return json.loads(report.read_text())

    def motion_file(self, rows):
        path = self.folder / "motion.tum"
        np.savetxt(path, rows, fmt="%.17g")
        return path


class SameAsTheCommand(Folder):
    def check(self, mesh, poses, options=(), **named):
        expected = self.cut_by_command(mesh, poses, *options)
        cut = incise.cut(mesh, poses, **named)
        for report in (expected, cut.report):
            del report["cut_time_us"]
        self.assertEqual(cut.report, expected)
        self.assertEqual(cut.warnings, expected["warnings"])
        self.assertEqual(format(cut.session.state_hash, "016x"), expected["state_hash"])
        return expected

    def test_report_for_each_policy_and_preference(self):
        mesh = self.folder / "liver.node"
        incise.Body.phantom("liver", 3_000).save(mesh)
        poses = self.motion_file([(t, x, y, 0.07, 0, 0, 0, 1) for t, x, y in ((0, 0.03, -0.1), (1, 0.03, 0.1))])
        states = set()
        for policy, prefer in (("conforming", "no-growth"), ("conforming", "balanced"), ("conforming", "exact"), ("croll", "exact")):
            expected = self.check(mesh, poses, ("--blade", BLADE_TEXT, "--policy", policy, "--prefer", prefer), blade=BLADE,
                                  policy=policy, prefer=prefer)
            self.assertGreater(expected["cut_faces"], 0)
            states.add(expected["state_hash"])
        self.assertEqual(len(states), 4)

    def test_configuration_file_and_dict(self):
        mesh, file = self.folder / "slab.vtu", self.folder / "config.json"
        incise.Body.phantom("slab", 1_000).save(mesh)
        config = {"blade": {"heel": [0, 0, 0.5], "tip": [0, 0, -0.5]}, "cut": {"prefer": "exact"}, "mesh": {"scale_to_metres": 2}}
        file.write_text(json.dumps(config))
        poses = self.motion_file([(t, 0.05, y, 0, 0, 0, 0, 1) for t, y in ((0, -0.1), (1, 0.3))])
        expected = self.check(mesh, poses, ("--config", file), config=file)
        self.assertEqual(expected["pieces"], 2)
        self.assertEqual(incise.cut(mesh, poses, config=config).report["state_hash"], expected["state_hash"])

    def test_capture_with_its_configuration(self):
        capture = SOURCE / "tests/replay/crossing_conforming.capture"
        self.assertGreater(self.check(SOURCE / "tests/replay/body", capture)["cut_faces"], 0)

    def test_arrays_of_what_the_files_hold(self):
        body = incise.Body.load(SOURCE / "tests/replay/body")
        again = incise.Body(body.points, body.tets, body.regions)
        self.assertEqual(again.content_hash, body.content_hash)
        left = incise.Body(np.asfortranarray(body.points), body.tets[:, [1, 0, 2, 3]].astype(np.int16))
        self.assertIn("left-handed", " ".join(left.warnings))
        random = np.random.default_rng(1)
        low, high = body.points.min(axis=0), body.points.max(axis=0)
        path = np.cumsum(random.normal(size=(40, 3)), axis=0)
        rows = np.zeros((40, 8))
        rows[:, 0] = np.arange(40) * 0.05
        rows[:, 1:4] = low + (path - path.min(axis=0)) / np.ptp(path, axis=0) * (high - low)
        rows[:, 4:] = [0.5, 0.5, -0.5, 0.5]
        expected = self.cut_by_command(SOURCE / "tests/replay/body", self.motion_file(rows))
        self.assertGreater(expected["cut_faces"], 0)
        for poses in (rows, np.asfortranarray(rows), np.repeat(rows, 2, axis=1)[:, ::2], rows.tolist(), incise.Motion(rows).poses):
            self.assertEqual(incise.cut(again, poses).report["state_hash"], expected["state_hash"])

    @unittest.skipUnless(os.environ.get("INCISE_DATA"), "INCISE_DATA is not set")
    def test_real_motions_in_a_real_mesh(self):
        data = pathlib.Path(os.environ["INCISE_DATA"])
        mesh = data / "meshes/sofa_liver2.msh"
        points = incise.Body.load(mesh).points
        for motion in sorted(data.glob("motions/*.csv")):
            with self.subTest(motion.name):
                poses = incise.Motion.load(motion)
                rows = poses.poses[:1500]
                rows[:, 1:4] = (rows[:, 1:4] - rows[:, 1:4].mean(axis=0)) / np.ptp(rows[:, 1:4]) * np.ptp(points) + points.mean(axis=0)
                size = float(np.ptp(points)) / 4
                expected = self.cut_by_command(mesh, self.motion_file(rows), "--blade", f"0,0,0:0,0,-{size!r}")
                found = incise.cut(mesh, rows, blade=((0, 0, 0), (0, 0, -size))).report
                self.assertEqual(found["state_hash"], expected["state_hash"])
                self.assertGreater(found["cut_faces"], 0)

    def test_errors_have_the_text_of_the_command(self):
        mesh = SOURCE / "tests/replay/body"
        bad_mesh, bad_motion, bad_config = (self.folder / name for name in ("bad.msh", "bad.csv", "bad.json"))
        bad_mesh.write_text("$MeshFormat\n9 0 8\n")
        bad_motion.write_text("t_s,x_m\n1,2\n")
        bad_config.write_text('{"cut": {"prefer": "fast"}}')
        good = self.motion_file([(0, 0, 0, 0, 0, 0, 0, 1), (1, 0, 0, 1, 0, 0, 0, 1)])
        for error, body, poses, config in ((incise.MeshError, bad_mesh, good, None), (incise.MeshError, "no.vtu", good, None),
                                           (incise.MotionError, mesh, bad_motion, None), (incise.Error, mesh, "no.csv", None),
                                           (incise.ConfigError, mesh, good, bad_config)):
            done = run_incise("cut", "--mesh", body, "--poses", poses, "--out", self.folder / "out.node",
                              *(("--config", config) if config else ()))
            with self.assertRaises(error) as caught:
                incise.cut(body, poses, config=config)
            self.assertEqual(f"incise: {caught.exception}\n", done.stderr)

    def test_a_blade_much_longer_than_the_body_is_refused(self):
        body, poses = incise.Body.phantom("slab", 1000), [(0, 0, 0, 0), (1, 0, 0, 1)]
        blade = {"heel": [0, 0, 0], "tip": [0, 0, -120]}
        for cut in (lambda: incise.cut(body, poses, blade=((0, 0, 0), (0, 0, -120))),
                    lambda: incise.Session(body, config={"blade": blade}).cut(poses),
                    lambda: incise.Session(body, config={"blade": blade}).push((0, 0, 0, 0, 0, 0, 0, 1))):
            with self.assertRaisesRegex(incise.Error, r"^the blade is 120 m long, the body .* m: this looks like millimetres"):
                cut()


class SameAsAServer(Folder):
    def test_states_of_recorded_sessions(self):
        for capture in sorted(SOURCE.glob("tests/replay/c*.capture")):
            with self.subTest(capture.name):
                facts = json.loads(run_incise("replay", capture, "--json").stdout)
                config = json.loads(run_incise("info", capture, "--json").stdout)["config"]
                session = incise.Session(SOURCE / "tests/replay/body", config)
                deltas = session.cut(capture).deltas
                self.assertEqual(len(deltas), facts["batches"])
                self.assertEqual(format(session.state_hash, "016x"), facts["state_hash"])

    def test_what_a_capture_has_beyond_poses_is_warned_of(self):
        capture = sorted(SOURCE.glob("tests/replay/c*.capture"))[0]
        config = json.loads(run_incise("info", capture, "--json").stdout)["config"]
        cut_off = self.folder / "open.capture"
        data = capture.read_bytes()
        end = len(data)
        while not cut_off.exists() or json.loads(run_incise("info", cut_off, "--json").stdout)["warnings"]:
            end -= 1  # until its last record, the end mark, is gone, and nothing is torn
            cut_off.write_bytes(data[:end])
        self.assertFalse([text for text in incise.Motion.load(capture).warnings if "closed" in text])
        for warnings in (incise.Motion.load(cut_off).warnings, incise.cut(SOURCE / "tests/replay/body", cut_off).warnings,
                         incise.Session(SOURCE / "tests/replay/body", config).cut(cut_off).warnings):
            self.assertEqual(len([text for text in warnings if "open.capture: was not closed" in text]), 1, warnings)

    def test_a_motion_without_poses_cuts_nothing(self):
        session = incise.Session(incise.Body.phantom("slab", 600))
        self.assertEqual(session.cut(incise.Motion(np.zeros((0, 8)))).warnings, ["nothing was cut: there is no pose in poses"])

    def test_buttons_engage_the_blade_as_configured(self):
        body, file, capture = self.folder / "slab.vtu", self.folder / "config.json", self.folder / "session.capture"
        incise.Body.phantom("slab", 1_000).save(body)
        config = {"blade": {"heel": [0, 0, 0], "tip": [0, 0, -0.12]}, "cut": {"engage_buttons": 2}}
        file.write_text(json.dumps(config))
        y = np.linspace(-0.02, 0.08, 100)
        button = 2 * (y > 0.03)
        motion = self.folder / "motion.csv"
        motion.write_text("t_s,x_m,y_m,z_m,button\n" + "".join(f"{i * 0.01},0.05,{y[i]!r},0.1,{button[i]}\n" for i in range(100)))
        done = run_incise("convert", motion, "--mesh", body, "--config", file, "--out", capture)
        self.assertEqual(done.returncode, 0, done.stderr)
        facts = json.loads(run_incise("replay", capture, "--json").stdout)
        rows = np.column_stack([np.arange(100) * 0.01, np.full(100, 0.05), y, np.full(100, 0.1)])
        states = set()
        for poses in (motion, incise.Motion(rows, buttons=button)):
            session = incise.Session(body, config)
            self.assertGreater(sum(delta.cut_faces for delta in session.cut(poses).deltas), 0)
            states.add(format(session.state_hash, "016x"))
        self.assertEqual(states, {facts["state_hash"]})
        always = incise.cut(body, motion, config=config).report
        self.assertGreater(always["cut_faces"], session.measure()["cut_faces"])

    def test_poses_one_by_one(self):
        body = incise.Body.phantom("slab", 1_000)
        rows = np.zeros((60, 8))
        rows[:, 0] = np.arange(60) * 0.01
        rows[:, 1:4] = np.linspace((0.05, -0.02, 0.1), (0.06, 0.08, 0.1), 60)
        rows[:, 7] = 1
        whole, single = incise.Session(body, blade=BLADE), incise.Session(body, blade=BLADE)
        deltas = whole.cut(rows).deltas
        steps = []
        for row in rows:
            self.assertEqual(single.push(row), "accepted")
            while delta := single.advance():
                steps.append(delta)
        single.end_stroke()
        while delta := single.advance():
            steps.append(delta)
        self.assertEqual([delta.state_hash for delta in steps], [delta.state_hash for delta in deltas])
        self.assertTrue(steps[-1].stroke_ended)
        self.assertEqual(single.push(rows[0]), "time not increasing")
        self.assertEqual(single.state_hash, whole.state_hash)

    def test_what_is_pushed_after_a_motion_has_a_clock_of_its_own(self):
        body = incise.Body.phantom("slab", 1_000)
        across = [(t, 0.05 + x, y, 0.1, 0, 0, 0, 1) for t, x, y in ((0.0, 0.0, -0.02), (0.2, 0.01, 0.08))]
        moved = [(t, x + 0.02, *rest) for t, x, *rest in across]
        twice = incise.Session(body, blade=BLADE)
        twice.cut(across)
        twice.cut(moved)
        for session in (incise.Session(body, blade=BLADE, forces=True), incise.cut(body, across, blade=BLADE).session):
            if session.revision == 0:
                session.cut(across)
            self.assertEqual([session.push(row) for row in moved][0], "accepted")
            session.end_stroke()
            while session.advance():
                pass
            self.assertEqual(session.measure()["pieces"], 3)
            self.assertEqual(session.state_hash, twice.state_hash)


class Fields(Folder):
    def body(self, **fields):
        plain = incise.Body.phantom("liver", 3_000)
        return plain, incise.Body(plain.points, plain.tets, np.arange(len(plain.tets)) % 3, **fields)

    def test_they_go_with_a_cut_body_by_every_way(self):
        plain, body = self.body()
        heat = (300 + 10 * plain.points[:, 0]).astype(np.float32)
        side = np.where(plain.points[:, 1] > 0, 5, -5).astype(np.int32)
        fibre = np.cross(plain.points, (0, 1, 0)).astype(np.float32)
        stress = np.random.default_rng(1).random((len(plain.tets), 9)).astype(np.float32)
        copy_of_region = body.regions.copy()
        _, body = self.body(vertex_fields={"heat": heat, "side": side, "fibre": fibre},
                            tet_fields={"stress": stress, "same as region": copy_of_region})
        self.assertEqual(sorted(body.vertex_fields), ["fibre", "heat", "side"])
        np.testing.assert_array_equal(body.tet_fields["stress"], stress)
        body.save(self.folder / "body.vtu")
        listed = json.loads(run_incise("info", "--json", self.folder / "body.vtu").stdout)["fields"]
        self.assertEqual([(f["name"], f["on"], f["components"], f["type"]) for f in listed],
                         [("heat", "vertices", 1, "float32"), ("side", "vertices", 1, "int32"), ("fibre", "vertices", 3, "float32"),
                          ("stress", "tetrahedra", 9, "float32"), ("same as region", "tetrahedra", 1, "int32")])
        self.assertIn("fibre, on vertices, 3 float32", run_incise("info", self.folder / "body.vtu").stdout)
        poses = self.folder / "poses.csv"
        poses.write_text("t_s,x_m,y_m,z_m\n" + "".join(f"{t},{x},{y},{z}\n" for t, x, y, z in THROUGH))
        done = run_incise("cut", "--mesh", self.folder / "body.vtu", "--poses", poses, "--blade", BLADE_TEXT,
                          "--out", self.folder / "cut.vtu")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertNotIn("left out", done.stderr)
        from_file = incise.Body.load(self.folder / "cut.vtu")
        cut = incise.cut(body, THROUGH, blade=BLADE, deltas=True)
        in_process = cut.session.current_body()
        np.testing.assert_array_equal(from_file.points, in_process.points)
        self.assertEqual(from_file.content_hash, in_process.content_hash)  # of what blades have left in it, too
        for one, other in ((from_file.vertex_fields, in_process.vertex_fields), (from_file.tet_fields, in_process.tet_fields)):
            self.assertEqual(sorted(one), sorted(other))
            for name, values in one.items():
                self.assertEqual(values.dtype, other[name].dtype)
                np.testing.assert_array_equal(values, other[name])
        np.testing.assert_allclose(from_file.vertex_fields["heat"], 300 + 10 * from_file.points[:, 0], rtol=0, atol=1e-3)
        self.assertEqual(set(from_file.vertex_fields["side"].tolist()), {5, -5})
        np.testing.assert_array_equal(from_file.tet_fields["same as region"], from_file.regions)
        # Step by step, and beside the ids.
        session = incise.Session(body, blade=BLADE)
        single = heat
        for delta in session.cut(THROUGH).deltas:
            single = delta.carry(single)
        np.testing.assert_array_equal(session.vertex_fields()["heat"], single)
        self.assertEqual(len(session.tet_fields()["stress"]), len(session.tets()))
        np.testing.assert_array_equal(session.tet_fields()["same as region"], session.tets()["region"])
        self.assertEqual((incise.Body.phantom("slab", 600).vertex_fields, incise.Session(plain).tet_fields()), ({}, {}))

    def test_a_file_that_has_no_place_for_them_is_a_warning(self):
        plain, body = self.body(vertex_fields={name: np.zeros(len(self.body()[0].points)) for name in "abcde"})
        said = ": is without the body's fields (a, b, c, d and 1 more); .vtu and .vtk have them"
        for source, ending in ((body, "msh"), (incise.Session(body), "msh"), (body, "node"), (body, "stl")):
            path = self.folder / f"out.{ending}"
            with self.assertWarns(UserWarning) as warned:
                source.save(path)
            self.assertEqual(str(warned.warning), f"{path}{said}")
            self.assertTrue(path.exists())
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            body.save(self.folder / "body.vtu")
            plain.save(self.folder / "plain.msh")
        poses, config, session = (self.folder / name for name in ("poses.csv", "config.json", "a.capture"))
        poses.write_text("t_s,x_m,y_m,z_m\n" + "".join(f"{t},{x},{y},{z}\n" for t, x, y, z in THROUGH))
        config.write_text(json.dumps({"blade": {"heel": BLADE[0], "tip": BLADE[1]}, "cut": {"engage": "always"}}))
        run_incise("convert", poses, "--mesh", self.folder / "body.vtu", "--config", config, "--out", session)
        for arguments in (("cut", "--mesh", self.folder / "body.vtu", "--poses", poses, "--blade", BLADE_TEXT), ("export", session)):
            for ending, expected in (("vtu", []), ("msh", [f"{self.folder / 'out.msh'}{said}"])):
                done = run_incise(*arguments, "--out", self.folder / f"out.{ending}", "--json")
                warned = [text for text in json.loads(done.stdout)["warnings"] if "orientations" not in text]
                of_cuts = f"{self.folder / 'out.msh'}: does not say which faces are cuts, so a further cut takes them for the body's boundary; .vtu and .vtk say it"
                self.assertEqual(of_cuts in done.stderr, ending == "msh", done.stderr)
                self.assertEqual([text for text in warned if text != of_cuts], expected, done.stderr)

    def test_an_export_has_them(self):
        plain, _ = self.body()
        _, body = self.body(vertex_fields={"heat": plain.points[:, 0]})
        body.save(self.folder / "body.vtu")
        poses = self.folder / "poses.csv"
        poses.write_text("t_s,x_m,y_m,z_m\n" + "".join(f"{t},{x},{y},{z}\n" for t, x, y, z in THROUGH))
        config = self.folder / "config.json"
        config.write_text(json.dumps({"blade": {"heel": BLADE[0], "tip": BLADE[1]}, "cut": {"engage": "always"}}))
        done = run_incise("convert", poses, "--mesh", self.folder / "body.vtu", "--config", config, "--out", self.folder / "a.capture")
        self.assertEqual(done.returncode, 0, done.stderr)
        done = run_incise("export", self.folder / "a.capture", "--out", self.folder / "end.vtu")
        self.assertEqual(done.returncode, 0, done.stderr)
        end = incise.Body.load(self.folder / "end.vtu")
        self.assertGreater(len(end.points), len(plain.points))
        np.testing.assert_allclose(end.vertex_fields["heat"], end.points[:, 0], rtol=0, atol=1e-6)

    def test_bad_ones_are_refused(self):
        points, tets = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2, 3]]
        good = incise.Body(points, tets, vertex_fields={"x": [1, 2, 3, float("nan")]}, tet_fields={"n": np.array([7], np.uint8)})
        self.assertTrue(np.isnan(good.vertex_fields["x"][3]))
        self.assertEqual(good.tet_fields["n"].tolist(), [7])
        for fields, error, text in (
                ({"x": [1, 2, 3]}, ValueError, r"vertex_fields\['x'\]: found shape \(3,\); accepted is \(4,\)"),
                ({"x": np.zeros((4, 10))}, ValueError, "1 to 9 components"), ({"x": np.zeros((4, 0))}, ValueError, "1 to 9"),
                ({"x": np.zeros((4, 3, 3))}, ValueError, "found shape"), ({"x": ["a"] * 4}, TypeError, "real numbers"),
                ({"": [1] * 4}, ValueError, "a name of 0 bytes"), ({"n" * 257: [1] * 4}, ValueError, "a name of 257 bytes"),
                ({"x": [2**31] * 4}, ValueError, "accepted is -2147483648 to 2147483647"), ({3: [1] * 4}, TypeError, "accepted is str"),
                ([("x", [1] * 4)], TypeError, "accepted is a dict"), ({"a\0b": [1] * 4}, ValueError, r"\['a\\x00b'\]: .* control character"),
                ({"\ud800": [1] * 4}, ValueError, "UTF-8"), ({"x": [1e300] * 4}, ValueError, r"\['x'\]\[0\] is 1e\+300"),
                ({"x": np.full(4, 2**64 - 1, np.uint64)}, ValueError, "is 18446744073709551615"),
                ({"x": np.ma.masked_less([1.0, 2, 3, 4], 2)}, ValueError, "1 masked numbers")):
            with self.subTest(fields=str(fields)[:40]), self.assertRaisesRegex(error, text):
                incise.Body(points, tets, vertex_fields=fields)


class Deltas(unittest.TestCase):
    def test_they_lead_from_the_body_to_the_state(self):
        body = incise.Body.phantom("liver", 2_000)
        session = incise.Session(body, blade=BLADE)
        points, tets = dict(enumerate(body.points)), {row["id"]: row for row in session.tets()}
        deltas = session.cut(THROUGH_SLOWLY).deltas
        moved = session.positions() * 1.01
        deltas += session.deform(moved) + session.cut(THROUGH_SLOWLY + (0, 0.02, 0, 0)).deltas
        self.assertGreater(len(deltas), 10)
        for number, delta in enumerate(deltas):
            self.assertEqual(delta.revision, number + 1)
            self.assertEqual(len(delta.provenance), len(delta.added_positions))
            for new, row in enumerate(delta.provenance, delta.first_added):
                self.assertLess(max(row["a"], row["b"]), new)
                self.assertTrue(0 <= row["t"] <= 1)
            points |= dict(zip(delta.moved.tolist(), delta.moved_positions))
            points |= dict(enumerate(delta.added_positions, delta.first_added))
            for tet in delta.removed:
                del tets[tet]
            tets |= {row["id"]: row for row in delta.upserted}
        self.assertTrue(sorted(points) == list(range(len(points))))
        np.testing.assert_array_equal(np.array([points[i] for i in range(len(points))]), session.positions())
        state = session.tets()
        self.assertTrue({int(i): str(row.tolist()) for i, row in tets.items()} == {int(row["id"]): str(row.tolist()) for row in state})
        self.assertEqual(xor_of(vertex_hashes(np.arange(len(points), dtype=np.uint32), session.positions())) ^
                         xor_of(tet_hashes(state["id"], state["vertices"], state["region"], state["cut_mask"])),
                         session.state_hash)
        self.assertEqual(deltas[-1].state_hash, session.state_hash)
        self.assertGreater(len({delta.stroke for delta in deltas}), 2)

    def test_carry_follows_the_material_in_a_body_that_deforms(self):
        session = incise.Session(incise.Body.phantom("liver", 3_000), blade=BLADE)
        rest, constant = session.rest_positions(), np.full(len(session.positions()), 7, np.float32)
        volume_rows = session.tets()
        ids = volume_rows["id"].astype(np.int64)
        deltas = session.cut(THROUGH_SLOWLY).deltas + session.deform(session.positions() * (1, 1.05, 0.97))
        deltas += session.cut(THROUGH_SLOWLY + (0, 0.02, 0, 0)).deltas
        for delta in deltas:
            np.testing.assert_allclose(delta.blends["weights"].sum(axis=1), 1, rtol=0, atol=1e-9)
            self.assertEqual(len(delta.elders), int((delta.upserted["id"] >= len(ids)).sum()))
            rest, constant, ids = delta.carry(rest), delta.carry(constant), delta.carry_tets(ids)
        self.assertGreater(sum(len(delta.blends) for delta in deltas), 50)
        np.testing.assert_allclose(rest, session.rest_positions(), rtol=0, atol=1e-9)
        self.assertEqual((constant.dtype, len(constant)), (np.float32, len(rest)))
        np.testing.assert_allclose(constant, 7, rtol=1e-6)
        # A new tetrahedron is in the place of its elder.
        body, now = session.body, session.tets()
        inside = session.rest_positions()[now["vertices"]].mean(axis=1)
        corners = body.points[body.tets[ids[now["id"]]]]
        size = np.linalg.norm(corners.max(axis=1) - corners.min(axis=1), axis=1)
        away = np.maximum(corners.min(axis=1) - inside, inside - corners.max(axis=1)).max(axis=1)
        self.assertLess((away / size).max(), 1)
        self.assertGreater((away <= 0).mean(), 0.95)
        for wrong, error in ((rest[:-1], ValueError), (np.zeros(()), ValueError), (["a"] * len(rest), TypeError),
                             (np.zeros((deltas[0].first_added, 0)), ValueError)):
            with self.assertRaises(error):
                deltas[0].carry(wrong)
        grows = next(delta for delta in deltas if len(delta.elders))
        with self.assertRaises(ValueError):
            grows.carry_tets(np.zeros(3))

    def test_pieces_and_faces(self):
        session = incise.Session(incise.Body.phantom("slab", 1_000), blade=BLADE)
        cut = session.cut(incise.Motion.lines([((0.03, y, 0.05), (0.03, y, -0.05)) for y in (-0.1, 0.1)]))
        numbers, counts = np.unique(session.pieces(), return_counts=True)
        self.assertEqual(session.measure()["pieces"], 2)
        named = {int(row["id"]): int(row["tets"]) for delta in cut.deltas for row in delta.pieces}
        self.assertEqual({int(n): int(c) for n, c in zip(numbers, counts) if n}, named)
        faces = session.faces()
        self.assertEqual(len(faces), session.measure()["boundary_faces"])
        self.assertEqual(int(faces["cut"].sum()), 2 * session.measure()["cut_faces"])
        corners = session.positions()[faces["vertices"]]
        volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6  # outward
        self.assertAlmostEqual(volume, session.measure()["volume"], 12)

    def test_files_number_the_pieces_as_the_session_does(self):
        small, large = incise.Body.phantom("slab", 500), incise.Body.phantom("slab", 2_000)
        body = incise.Body(np.vstack([small.points + (0, 0.5, 0), large.points]),
                           np.vstack([small.tets.astype(int), large.tets.astype(int) + len(small.points)]))
        session = incise.Session(body, blade=BLADE)
        with tempfile.TemporaryDirectory() as folder:
            for cuts, x in enumerate((None, 0.03, 0.01)):
                if cuts:
                    session.cut(incise.Motion.lines([((x, y, 0.05), (x, y, -0.05)) for y in (-0.1, 0.1)]))
                pieces = session.pieces()
                self.assertEqual(np.unique(pieces).tolist(), list(range(cuts + 2)))
                self.assertEqual(session.measure()["pieces"], cuts + 2)
                for name in ("cut.vtu", "cut.glb"):
                    session.save(pathlib.Path(folder) / name)
                np.testing.assert_array_equal(vtk_array(pathlib.Path(folder) / "cut.vtu", "piece"), pieces)
                faces = session.faces()
                of_face = pieces[np.searchsorted(session.tets()["id"], faces["tet"])]
                nodes = glb_points(pathlib.Path(folder) / "cut.glb")
                self.assertEqual(list(nodes), [f"piece_{n}" for n in range(cuts + 2)])
                for number in range(cuts + 2):
                    corners = session.positions()[np.unique(faces["vertices"][of_face == number])]
                    points = nodes[f"piece_{number}"]
                    np.testing.assert_allclose(points.min(axis=0), corners.min(axis=0), rtol=0, atol=1e-6)
                    np.testing.assert_allclose(points.max(axis=0), corners.max(axis=0), rtol=0, atol=1e-6)
            body.save(pathlib.Path(folder) / "body.glb")
            self.assertEqual(list(glb_points(pathlib.Path(folder) / "body.glb")), ["piece_0", "piece_1"])

    def test_the_texture_of_a_surface_stays_on_the_outside(self):
        # A tetrahedron of 10 cm whose texture is its place: u is x, v is y, but for the slanted side.
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "body.obj"
            path.write_text("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nvt 0 0\nvt 0.1 0\nvt 0 0.1\nvt 5 5\nvt 6 5\nvt 5 6\n"
                            "f 1/1 3/3 2/2\nf 1/1 2/2 4/1\nf 1/1 4/1 3/3\nf 2/4 3/5 4/6\n")
            body = incise.Body.load(path, {"mesh": {"target_tets": 400}})
            session = incise.Session(body, blade=((0, 0, 0), (0, 0, -0.3)))
            session.cut(incise.Motion.lines([((0.03, y, 0.2), (0.03, y, -0.1)) for y in (-0.1, 0.2)]))
            self.assertGreater(session.measure()["cut_faces"], 0)
            session.save(pathlib.Path(folder) / "cut.glb")
            self.assertEqual((pathlib.Path(folder) / "cut.glb").read_bytes()[:4], b"glTF")
            body.save(pathlib.Path(folder) / "body.glb")
        faces, uvs, origins = session.faces(), session.corner_uvs(), session.origins()
        self.assertEqual(uvs.shape, (len(faces), 3, 2))
        self.assertEqual(origins.shape, (len(session.tets()), 4))
        cut = faces["cut"].astype(bool)
        self.assertEqual(int((origins != 0xFFFFFFFF).sum()), int((~cut).sum()))
        self.assertEqual(set(origins[origins != 0xFFFFFFFF].tolist()), {0, 1, 2, 3})
        self.assertTrue(np.isnan(uvs[cut]).all())
        places = session.positions()[faces["vertices"]]
        straight = ~cut & (uvs < 1).all(axis=(1, 2))
        self.assertGreater(int(straight.sum()), 50)
        np.testing.assert_allclose(uvs[straight], places[straight][:, :, :2], atol=1e-6)
        plain = incise.Session(incise.Body.phantom("slab", 600))
        self.assertRaisesRegex(ValueError, "not filled from a surface", plain.corner_uvs)

    def test_views_cannot_be_written_and_outlive_their_owners(self):
        body = incise.Body.phantom("slab", 600)
        cut = incise.cut(body, THROUGH, blade=BLADE, deltas=True)
        delta = next(delta for delta in cut.deltas if delta.cut_faces)
        arrays = [delta.upserted, delta.moved_positions, delta.provenance, delta.boundary_upserted, body.points, body.tets]
        for array in arrays:
            self.assertFalse(array.flags.owndata)
            with self.assertRaises(ValueError):
                array.flags.writeable = True
        self.assertTrue(np.shares_memory(delta.upserted, delta.upserted))
        copies = [array.copy() for array in arrays]
        del body, cut, delta
        gc.collect()
        [bytearray(1 << 20) for _ in range(20)]
        for array, copy in zip(arrays, copies):
            np.testing.assert_array_equal(array, copy)

    def test_deformation_holds_what_would_invert(self):
        session = incise.Session(incise.Body.phantom("slab", 600))
        positions = session.positions()
        tet = session.tets()["vertices"][100]
        positions[tet[0]] += 3 * (positions[tet[1:]].mean(axis=0) - positions[tet[0]])
        delta, = session.deform(positions)
        self.assertEqual(delta.stroke, 0)
        self.assertEqual(delta.held.tolist(), [tet[0]])
        self.assertEqual(session.measure()["inverted"], 0)
        np.testing.assert_array_equal(session.rest_positions(), incise.Body.phantom("slab", 600).points)
        delta, = session.deform([[0, 0, -1e-4]] + session.positions()[5], ids=[5])
        self.assertEqual(delta.moved.tolist(), [5])

    def test_a_deformed_body_is_saved_with_its_rest_positions(self):
        phantom = incise.Body.phantom("slab", 600)
        body = incise.Body(phantom.points, phantom.tets, vertex_fields={"x": phantom.points[:, 0]})
        session = incise.Session(body, blade=BLADE)
        session.cut(THROUGH_SLOWLY)
        self.assertEqual(sorted(session.current_body().vertex_fields), ["x"], "a body at rest needs no more")
        session.deform(session.positions() * (1, 1.2, 1))
        used = np.unique(session.tets()["vertices"])
        now, rest = session.positions()[used], session.rest_positions()[used]
        with tempfile.TemporaryDirectory() as folder:
            loaded = [session.current_body()]
            for name in ("deformed.vtu", "deformed.vtk"):
                session.save(pathlib.Path(folder) / name)
                loaded.append(incise.Body.load(pathlib.Path(folder) / name))
        for found in loaded:
            np.testing.assert_array_equal(found.points, now)
            self.assertEqual(sorted(found.vertex_fields), ["rest_position", "x"])
            np.testing.assert_array_equal(found.vertex_fields["rest_position"], rest.astype(np.float32))
            np.testing.assert_allclose(found.vertex_fields["x"], rest[:, 0], atol=1e-6)
            # What is carried on is where the material was in the first body.
            later = incise.Session(found, blade=BLADE)
            np.testing.assert_array_equal(later.rest_positions(), now)
            later.deform(later.positions() * (1.1, 1, 1))
            np.testing.assert_array_equal(later.current_body().vertex_fields["rest_position"], rest.astype(np.float32))

    def test_forces_of_the_contact_model(self):
        body = incise.Body.phantom("slab", 1_000)
        z = np.concatenate([np.linspace(0.13, 0.11, 100), np.linspace(0.11, 0.13, 100)])
        rows = np.column_stack([np.arange(200) * 0.002, np.full(200, 0.05), np.full(200, 0.03), z])
        cut = incise.cut(body, rows, blade=((-0.01, 0, -0.1), (0.01, 0, -0.1)), forces=True)
        self.assertEqual(cut.forces.shape, (200, 3))
        outside = z > 0.1201  # the slab's upper face is at 0.02, the edge 0.1 below the tool
        self.assertEqual(np.abs(cut.forces[:100][outside[:100]]).max(), 0)
        self.assertGreater(cut.forces[:100, 2].max(), 0.5)  # it resists
        stiffer = incise.cut(body, rows, blade=((-0.01, 0, -0.1), (0.01, 0, -0.1)), forces=True,
                             config={"haptics": {"toughness_j_m2": 1000}})
        self.assertGreater(stiffer.forces[:, 2].max(), 1.5 * cut.forces[:, 2].max())
        self.assertIsNone(incise.cut(body, rows).forces)


class BadInput(unittest.TestCase):
    def test_arrays(self):
        tet, one = np.eye(4)[:, :3], [[0, 1, 2, 3]]
        np.seterr(invalid="ignore")
        poses = np.zeros((2, 8))
        poses[:, 0], poses[:, 7] = (0, 1), 1
        wrong_poses = [poses[::-1], poses[:, :5], poses[0], np.where(poses == 1, np.nan, poses), poses * np.inf, poses.astype(str),
                       poses + 1j, np.zeros((2, 8)), "no file", None, 3, poses.astype(object), [[1], [2, 3]], np.ma.masked, poses == 1]
        session = incise.Session(incise.Body(tet, one))
        cases = [
            *((incise.Body, (points, one)) for points in
              (tet[:3], tet[:, :2], tet.ravel(), tet * np.nan, tet * np.inf, tet + 1j, tet.astype(str), tet == 1, None, "points", [],
               np.zeros((4, 3)), tet * 1e200, tet.astype(object), np.zeros((0, 3)))),
            *((incise.Body, (tet, tets)) for tets in
              ([[0, 1, 2, 4]], [[-1, 0, 1, 2]], [[0, 1, 2, 2]], [[0, 1, 2]], [0, 1, 2, 3], [[0, 1, 2, 3.0]], [[True, False, True, True]],
               [], [[2**63, 0, 1, 2]], [[2**32, 1, 2, 3]], None, "tets", [[0, 1, 2, 3]] * 2)),
            *((incise.Body, (tet, one, regions)) for regions in ([], [1, 2], [1.5], [2**40], "a", [[1]])),
            *((incise.Motion, (rows,)) for rows in wrong_poses if not isinstance(rows, str)),
            *((session.cut, (rows,)) for rows in wrong_poses),
            *((incise.cut, (session.body, rows)) for rows in wrong_poses),
            *((incise.Motion.lines, (lines,)) for lines in
              (np.zeros((2, 2, 3)), np.zeros((2, 3)), [[[0, 0, 0], [0, 0, 1]], [[0, 0, 0], [0, 0, 2]]], [[[0, 0, np.nan], [0, 0, 1]]])),
            (incise.Motion.lines, ([[[0, 0, 0], [0, 0, 1]]] * 2, [1, 1])),
            (incise.Motion.lines, ([[[0, 0, 0], [0, 0, 1]]] * 2, [1])),
            *((session.push, (row,)) for row in (poses, poses[0, :7], poses[0] * np.nan, "x", [1e300] + [0] * 6 + [1])),
            (session.push, (poses[0], 1, 8)), (session.push, (poses[0], 1, -1)), (session.push, (poses[0], -1)),
            *((session.deform, (rows,)) for rows in (tet[:2], tet * np.nan, "x", None, np.zeros((9, 3)))),
            *((session.deform, (tet[:2], ids)) for ids in ([1, 0], [0, 0], [0, 4], [-1, 0], [0.0, 1.0], [0], [[0], [1]])),
        ]
        for call, arguments in cases:
            with self.subTest(f"{call.__name__}{arguments}"), self.assertRaises((TypeError, ValueError, incise.Error)) as caught:
                call(*arguments)
            self.assertNotIn("\n", str(caught.exception)) if isinstance(caught.exception, incise.Error) else None
        self.assertEqual(session.revision, 0)
        self.assertEqual(len(session.deform(tet * 2)), 1)

    def test_messages_name_what_was_given(self):
        tet, one = np.eye(4)[:, :3], [[0, 1, 2, 3]]
        delta = incise.Session(incise.Body(tet, one)).deform(tet * 2)[0]
        largest = np.array([2**64 - 1, 0], np.uint64)
        masked = np.ma.masked_greater(tet, 0.5)
        for call, text in (
                (lambda: incise.Motion(np.zeros((3, 7))), r"poses: found shape \(3, 7\); accepted is \(n, 8\) or \(n, 4\)"),
                (lambda: incise.cut(incise.Body(tet, one), np.zeros(8)), r"found shape \(8,\); accepted is \(n, 8\) or \(n, 4\)"),
                (lambda: incise.Body(tet, np.array([[0, 1, 2, 2**64 - 1]], np.uint64)), r"tets\[0, 3\] is 18446744073709551615"),
                # -5 as int64, which would be a region.
                (lambda: incise.Body(tet, one, np.array([2**64 - 5], np.uint64)), r"regions\[0\] is 18446744073709551611"),
                (lambda: incise.Motion([(0, 0, 0, 0), (1, 0, 0, 0)], buttons=largest), r"buttons\[0\] is 18446744073709551615"),
                (lambda: incise.Body(masked, one), "points: found an array with 3 masked numbers"),
                (lambda: incise.Motion(np.ma.masked_equal(np.eye(2, 4), 1)), "poses: found an array with 2 masked numbers"),
                (lambda: delta.carry(np.ma.masked_less(np.arange(4.0), 1)), "values: found an array with 1 masked numbers"),
                (lambda: incise.Body(tet, one).save("x\0.vtu"), r"path: found 'x\\x00.vtu'"),
                (lambda: incise.Body.load("x\0.vtu"), r"path: found 'x\\x00.vtu'")):
            with self.subTest(text), self.assertRaisesRegex(ValueError, text):
                call()
        self.assertEqual(len(incise.Body(np.ma.masked_array(tet), one).points), 4)  # nothing is masked

    def test_objects_that_were_never_made_are_refused(self):
        classes = [incise.Body, incise.Motion, incise.Delta, incise.Session, incise.Cut]
        takes_one = ("save", "cut", "push", "deform", "carry", "carry_tets")
        for kind in classes:
            made_by = r"this incise\." + kind.__name__ + " is empty.*; make one with "
            names = {name for name, member in vars(kind).items() if not isinstance(member, staticmethod)}
            for name in (names - {name for name in names if name.startswith("__")}) | names & {"__len__", "__repr__"}:
                with self.subTest(f"{kind.__name__}.{name}"), self.assertRaisesRegex(TypeError, made_by):
                    member = getattr(kind.__new__(kind), name)
                    member(*["x.vtu"] * (name in takes_one))
        body, motion, session = (kind.__new__(kind) for kind in (incise.Body, incise.Motion, incise.Session))
        whole = incise.Body.phantom("slab", 600)
        for call in (lambda: incise.Session(body), lambda: incise.cut(body, THROUGH), lambda: incise.cut(whole, motion),
                     lambda: incise.Session(whole).cut(motion), lambda: session.cut(THROUGH)):
            with self.assertRaisesRegex(TypeError, "is empty"):
                call()

        class Early(incise.Body):
            def __init__(self):
                self.before = str(self.assert_empty())
                super().__init__(np.eye(4)[:, :3], [[0, 1, 2, 3]])

            def assert_empty(self):
                try:
                    return self.points
                except TypeError as error:
                    return error

        early = Early()
        self.assertIn("super().__init__() first", early.before)
        self.assertEqual(len(early.points), 4)
        body.__init__(np.eye(4)[:, :3], [[0, 1, 2, 3]])
        self.assertEqual(incise.Session(body).measure()["tets"], 1)

    def test_poses_that_are_rejected(self):
        session = incise.Session(incise.Body.phantom("slab", 600))
        self.assertEqual(session.push((0, 2e4, 0, 0, 0, 0, 0, 1)), "not finite or more than 10 km from the origin")
        self.assertEqual(session.push((0, 0, 0, 0, 0, 0, 0, 2)), "quaternion not of unit length")
        self.assertIsNone(session.advance())

    def test_names(self):
        body = incise.Body.phantom("slab", 600)
        for call in (lambda: incise.Body.phantom("heart"), lambda: incise.Body.phantom("slab", 499), lambda: incise.Body.load(3),
                     lambda: incise.Body.load("x.vtu", config=3), lambda: incise.Session(body, {"cut": 1}), lambda: body.save("x.foo"),
                     lambda: incise.Session(body, blade=((0, 0, 0), (0, 0, 0))), lambda: incise.Session(body, blade=((0, 0), (1, 1))),
                     lambda: incise.Session(body, policy="best"), lambda: incise.Session(body, prefer=3), lambda: incise.Session(3),
                     lambda: incise.Session(body, {"cut": {"speed_limit_m_s": float("nan")}}), lambda: body.save("/no/such/x.vtu"),
                     lambda: incise.cut(body, incise.Motion.lines([((0, 0, 0), (0, 0, 1))]), blade=BLADE),
                     lambda: copy.copy(incise.Session(body)), lambda: pickle.dumps(body), lambda: incise.Delta(), lambda: incise.Cut()):
            with self.assertRaises((TypeError, ValueError, incise.Error, RuntimeError)):
                call()


class Threads(unittest.TestCase):
    def long_cut(self, session):
        """A hand that wanders in the body: hundreds of batches."""
        random = np.random.default_rng(1)
        rows = np.zeros((400, 8))
        rows[:, 0] = np.arange(len(rows)) * 0.01
        rows[:, 1:4] = np.cumsum(random.normal(scale=0.002, size=(len(rows), 3)), axis=0) % (0.1, 0.06, 0.02) + (0, 0, 0.1)
        rows[:, 7] = 1
        while True:
            try:
                return session.cut(rows, deltas=False)
            except incise.Error:
                pass  # the other thread is looking whether the session is in use

    def wait_until_busy(self, session, thread):
        while thread.is_alive():
            try:
                session.revision
            except incise.Error as error:
                return str(error)
            time.sleep(0.001)  # or the other thread would find the session in use by this one, again and again
        return ""

    def test_a_second_thread_gets_an_error_and_others_run_meanwhile(self):
        session = incise.Session(incise.Body.phantom("slab", 2_000), {"cut": {"speed_limit_m_s": 100}}, blade=((0, 0, 0), (0, 0, -0.1)))
        thread = threading.Thread(target=self.long_cut, args=(session,))
        thread.start()
        # This thread could not see that the session is busy if the other one kept the GIL.
        self.assertIn("in use by another thread", self.wait_until_busy(session, thread))
        other = incise.cut(incise.Body.phantom("slab", 600), THROUGH, blade=BLADE)
        self.assertEqual(other.report["pieces"], 2)
        thread.join()
        self.assertEqual(session.measure()["inverted"], 0)

    def test_ctrl_c_ends_a_cut_between_two_batches(self):
        session = incise.Session(incise.Body.phantom("slab", 2_000), {"cut": {"speed_limit_m_s": 100}}, blade=((0, 0, 0), (0, 0, -0.1)))

        def interrupt():
            self.wait_until_busy(session, threading.main_thread())
            os.kill(os.getpid(), signal.SIGINT)

        watcher = threading.Thread(target=interrupt)
        watcher.start()
        with self.assertRaises(KeyboardInterrupt):
            self.long_cut(session)
        watcher.join()
        before = session.revision
        session.cut([(0, 0.05, -0.1, 0.05), (0.1, 0.05, 0.1, 0.05)])
        self.assertGreater(session.revision, before)
        self.assertEqual(session.measure()["inverted"], 0)


class Leaks(unittest.TestCase):
    def test_two_thousand_cuts(self):
        body = incise.Body.phantom("slab", 600)

        def cuts(number):
            for i in range(number):
                x = 0.01 + 0.08 * i / number
                cut = incise.cut(body, [(0, x, -0.1, 0.07), (1, x, 0.1, 0.07)], blade=BLADE, deltas=True, forces=i % 10 == 0)
                cut.deltas[0].upserted.sum
                if i % 10 == 0:
                    incise.Body(body.points, body.tets).warnings
                    with self.assertRaises(ValueError):
                        incise.Body(body.points, [[0, 1, 2, 3], [0, 1, 2, 1 << 30]])
                    with self.assertRaises(incise.Error):
                        cut.session.cut("no such file")

        cuts(200)  # what is kept once: tables, pools, caches
        before = allocated_bytes()
        cuts(2_000)
        self.assertLess(allocated_bytes() - before, 200_000)  # 100 bytes a cut; a delta alone is some 10,000


class Documented(unittest.TestCase):
    def test_every_name_is_documented_and_in_the_stubs(self):
        stubs = {node.name: node for node in ast.parse((SOURCE / "client/python/incise/_core.pyi").read_text()).body
                 if isinstance(node, (ast.ClassDef, ast.FunctionDef))}
        for name in incise.__all__:
            there = getattr(incise, name)
            self.assertIn(name, stubs)
            if isinstance(there, type) and issubclass(there, Exception):
                continue
            self.assertTrue(there.__doc__, name)
            if not isinstance(there, type):
                continue
            members = {member for member in vars(there) if not member.startswith("_")}
            stubbed = {node.name if isinstance(node, ast.FunctionDef) else node.target.id for node in stubs[name].body}
            self.assertEqual({member for member in stubbed if not member.startswith("_")}, members, name)
            for member in members:
                self.assertTrue(getattr(there, member).__doc__, f"{name}.{member}")


if __name__ == "__main__":
    unittest.main()
