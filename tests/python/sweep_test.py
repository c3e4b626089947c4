"""incise sweep: workers that are killed, interruptions, a Dask cluster: sweep_test.py BUILD."""

import hashlib
import json
import os
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import time
import unittest

import h5py
import numpy as np

import incise
import incise.sweep

BUILD = pathlib.Path(sys.argv.pop(1)).resolve()
SOURCE = pathlib.Path(__file__).resolve().parents[2]
SPEC = {"bodies": [str(SOURCE / "tests/replay/body"), {"phantom": "slab", "tets": 800}],
        "motions": [str(SOURCE / "tests/replay/planar_conforming.capture"), {"random_cuts": 19, "seed": 5}],
        "parameters": {"cut.prefer": ["balanced", "exact"]}, "config": {"blade": {"heel": [0, 0, 0], "tip": [0, 0, -0.03]}},
        "store": ["states", "deltas", "forces"]}


def children(pid):
    return [int(child) for child in pathlib.Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


class Sweep(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        """A sweep on local processes that nothing disturbs: what all others must be equal to."""
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.local = pathlib.Path(folder.name) / "local"
        spec = pathlib.Path(folder.name) / "spec.json"
        spec.write_text(json.dumps(SPEC))
        # Nobody has filled its bodies before: the others find the fills in the cache.
        done = subprocess.run([BUILD / "bin/incise", "sweep", spec, "--out", cls.local, "--json"], capture_output=True, text=True, check=True,
                              env=dict(os.environ, XDG_CACHE_HOME=str(pathlib.Path(folder.name) / "cache")))
        figures = json.loads(done.stdout)
        assert (figures["samples"], figures["made"], figures["shards"]) == (80, 80, 4), figures

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def spec(self, **changes):
        path = self.folder / "spec.json"
        path.write_text(json.dumps(SPEC | changes))
        return path

    def test_a_single_sample_and_shard(self):
        spec = self.spec(bodies=[{"phantom": "slab", "tets": 800}], motions=[{"random_cuts": 1, "seed": 5}], parameters={}, store=["states"])
        self.assertRegex(self.run_sweep(spec, "--out", self.folder / "one"), r"^1 sample in 1 shard; 1 made now in [\d.]+ s\n$")

    def test_a_sample_that_is_written_is_named(self):
        body = incise.Body.phantom("slab", 800)
        incise.Body(body.points, body.tets, vertex_fields={"heat": body.points[:, 0]}).save(self.folder / "body.vtu")
        spec = self.spec(bodies=[str(self.folder / "body.vtu")], motions=[{"random_cuts": 1, "seed": 5}], parameters={})
        out = self.folder / "s3.msh"
        with self.start(spec, "--sample", "0", "--out", out) as process:
            printed, errors = process.communicate(timeout=100)
        self.assertTrue(printed.endswith(f"; written to {out}\n"), printed)
        self.assertEqual(errors, f"warning: {out}: is without the body's fields (heat); .vtu and .vtk have them\n")
        self.assertTrue(out.exists())

    def start(self, *arguments):
        return subprocess.Popen([BUILD / "bin/incise", "sweep", *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                text=True)

    def run_sweep(self, *arguments, status=0):
        with self.start(*arguments) as process:
            printed, errors = process.communicate(timeout=100)
        self.assertEqual(process.returncode, status, errors)
        return printed if status == 0 else errors

    def files(self, out):
        """Digests of what a data set holds."""
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in out.iterdir() if path.name != ".lock"}

    def assert_same_data_set(self, out, expected):
        """The same bytes; names what differs in a shard."""
        found, wanted = self.files(out), self.files(expected)
        if found == wanted:
            return
        differing = {}
        for name in sorted(found.keys() & wanted.keys()):
            if found[name] == wanted[name] or not name.endswith(".h5"):
                continue
            with h5py.File(out / name) as a, h5py.File(expected / name) as b:
                names = ["/"]
                a.visit(names.append)
                differing[name] = [f"{path} {what}" for path in names if (what := self.difference(a[path], b.get(path)))][:5]
        self.fail(f"{out} and {expected} differ: {found} {wanted} {differing}")

    def difference(self, a, b):
        """In which way an object of one file is another in another file; empty where it is not."""
        if b is None:
            return "is missing"
        changed = [f"{key}: {a.attrs[key]} and {b.attrs.get(key)}" for key in a.attrs if a.attrs[key] != b.attrs.get(key)]
        if isinstance(a, h5py.Dataset) and (a.dtype, a.shape, a[()].tobytes()) != (b.dtype, b.shape, b[()].tobytes()):
            changed.append(f"{a.dtype} {a[()]} and {b.dtype} {b[()]}")
        return "; ".join(changed)

    def test_what_a_shard_holds(self):
        manifest = json.loads((self.local / "manifest.json").read_text())
        self.assertTrue(manifest["complete"])
        hashes = [state for shard in manifest["shards"] for state in shard["state_hashes"]]
        self.assertEqual(len(hashes), 80)
        for number in (0, 25, 41, 79):
            with h5py.File(self.local / f"shard-{number // 20:06}.h5") as file:
                group = file[f"{number:08}"]
                report = json.loads(group.attrs["report"])
                self.assertEqual(group.attrs["state_hash"], hashes[number])
                self.assertEqual(report["state_hash"], hashes[number])
                state = group["state/tets"][:]
                self.assertEqual(len(state), report["tets"])
                self.assertEqual(len(np.unique(group["state/pieces"])), report["pieces"])
                self.assertEqual(len(group["forces"]), len(group["poses"]))
                last = max(group["deltas"])
                self.assertEqual(len(group["deltas"]), int(last))
                line = group.attrs["line"].replace("SPEC", str(self.spec())).split()[2:]
            self.assertIn(hashes[number], self.run_sweep(*line))
        # The same by the command line alone.
        report, config = self.folder / "report.json", self.folder / "config.json"
        config.write_text(json.dumps(SPEC["config"]))
        subprocess.run([BUILD / "bin/incise", "cut", "--mesh", SPEC["bodies"][0], "--poses", SPEC["motions"][0], "--config", config,
                        "--prefer", "exact", "--out", self.folder / "out.node", "--report", report], check=True, capture_output=True)
        self.assertEqual(json.loads(report.read_text())["state_hash"], hashes[1])

    def test_workers_killed_twice(self):
        out = self.folder / "killed"
        with self.start(self.spec(), "--out", out, "--workers", "2") as process:
            killed = set()
            while len(killed) < 2 and process.poll() is None:
                for child in set(children(process.pid)) - killed:
                    os.kill(child, signal.SIGKILL)
                    killed.add(child)
            _, errors = process.communicate(timeout=100)
        self.assertEqual(process.returncode, 0, errors)
        self.assertGreaterEqual(len(killed), 2)
        self.assert_same_data_set(out, self.local)

    def test_it_goes_on_after_kill_and_after_an_interruption(self):
        out = self.folder / "resumed"
        for end in (signal.SIGKILL, signal.SIGINT):
            before = len(list(out.glob("shard-*.h5")))
            with self.start(self.spec(), "--out", out, "--workers", "1") as process:
                while len(list(out.glob("shard-*.h5"))) == before and process.poll() is None:
                    time.sleep(0.001)
                process.send_signal(end)
                _, errors = process.communicate(timeout=100)
            if process.returncode == 1:
                self.assertEqual(errors, "incise: interrupted; start it again to go on\n")
        there = len(list(out.glob("shard-*.h5")))
        self.assertGreaterEqual(there, 2)
        figures = json.loads(self.run_sweep(self.spec(), "--out", out, "--json"))
        self.assertEqual(figures["made"], 20 * (4 - there))
        self.assert_same_data_set(out, self.local)
        errors = self.run_sweep(self.spec(store=["forces"]), "--out", out, status=1)
        self.assertIn("choose another --out", errors)
        self.assert_same_data_set(out, self.local)

    def test_two_at_once(self):
        out = self.folder / "twice"
        with self.start(self.spec(), "--out", out, "--workers", "1") as process:
            while not list(out.glob("shard-*.h5")) and process.poll() is None:
                time.sleep(0.001)
            process.send_signal(signal.SIGSTOP)
            self.assertIn("another sweep is writing there", self.run_sweep(self.spec(), "--out", out, status=1))
            process.send_signal(signal.SIGCONT)
            process.communicate(timeout=100)
        self.assertEqual(process.returncode, 0)
        self.assert_same_data_set(out, self.local)

    def test_a_dask_cluster_whose_workers_are_killed(self):
        try:
            import distributed  # noqa: F401  pylint: disable=unused-import,import-outside-toplevel
        except ModuleNotFoundError:
            self.skipTest("python3-distributed is not installed")
        scheduler = subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0",
                                      "--no-dashboard", "--no-show"], stderr=subprocess.PIPE, text=True)
        self.addCleanup(scheduler.stderr.close)
        self.addCleanup(scheduler.wait)
        self.addCleanup(scheduler.kill)
        address = next(found[0] for found in (re.search(r"tcp://127\.0\.0\.1:\d+", line) for line in scheduler.stderr) if found)
        workers = []

        def start_worker():
            worker = subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny",
                                       "--no-dashboard"], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, cwd=self.folder,
                                      env=dict(os.environ, PYTHONPATH=str(BUILD / "python")))
            workers.append(worker)
            self.addCleanup(worker.wait)
            self.addCleanup(worker.kill)

        start_worker()
        out = self.folder / "dask"
        with self.start(self.spec(), "--out", out, "--dask", address) as process:
            while not list(out.glob("shard-*.h5")) and process.poll() is None:
                time.sleep(0.01)
            for _ in range(2):  # it has a shard in hand
                workers[-1].kill()
                start_worker()
            printed, errors = process.communicate(timeout=100)
        self.assertEqual(process.returncode, 0, errors)
        self.assertIn("80 samples", printed)
        self.assert_same_data_set(out, self.local)

    def test_errors(self):
        out = self.folder / "errors"
        for change, text in (({"bodies": []}, "bodies: found []; accepted is a list of one or more"),
                             ({"bodies": ["no.vtu"]}, "no.vtu: no such file"),
                             ({"bodies": [{"phantom": "heart"}]}, 'accepted is "liver", "cylinder" or "slab"'),
                             ({"motions": [3]}, 'motions: found 3; accepted is a path or {"random_cuts": N, "seed": S}'),
                             ({"motions": ["none.csv"]}, "none.csv: cannot be opened"),
                             ({"parameters": {"cut.speed": [1]}}, 'unknown key "cut.speed"'),
                             ({"parameters": {"mesh.path": ["x"]}}, "accepted is a key of the sections cut, blade, haptics"),
                             ({"parameters": {"cut.prefer": ["fast"]}}, 'cut.prefer: found "fast"'),
                             ({"store": ["all"]}, "store: found"), ({"shards": 3}, 'unknown key "shards"')):
            with self.subTest(text):
                errors = self.run_sweep(self.spec(**change), "--out", out, status=1)
                self.assertIn(text, errors)
                self.assertRegex(errors, r"\Aincise: [^\n]*\n\Z")
        self.assertIn("No such file", self.run_sweep("none.json", "--out", out, status=1))
        (self.folder / "empty.json").write_text("")
        self.assertIn("empty.json: is no JSON (Expecting value: line 1 column 1 (char 0)); client/CLIENTS.md shows what a SPEC is",
                      self.run_sweep(self.folder / "empty.json", "--out", out, status=1))
        for place, why in (("empty.json", "File exists"), ("empty.json/below", "Not a directory")):
            self.assertIn(f"{place}: cannot be the data set's directory: {why}; choose another",
                          self.run_sweep(self.spec(), "--out", self.folder / place, status=1))
        out.mkdir()
        (out / "manifest.json").write_text("{")
        self.assertRegex(self.run_sweep(self.spec(), "--out", out, status=1), r"manifest.json: cannot be read \(.*\); remove it")
        (out / "manifest.json").unlink()
        with open("/dev/full", "w", encoding="ascii") as full:
            done = subprocess.run([BUILD / "bin/incise", "sweep", self.spec(), "--sample", "0"], stdout=full, stderr=subprocess.PIPE, text=True,
                                  check=False)
        self.assertEqual((done.returncode, done.stderr),
                         (1, "incise: the standard output could not be written to its end: No space left on device\n"))
        body = self.folder / "body.vtu"
        incise.Body.phantom("slab", 800).save(body)
        for read in (body, self.folder / "spec.json"):
            errors = self.run_sweep(self.spec(bodies=[str(body)]), "--sample", "0", "--out", read, status=1)
            self.assertIn("would overwrite", errors)
        with self.assertRaisesRegex(incise.Error, r"is a device or a pipe; accepted is"):
            incise.Session(incise.Body.load(body)).save("/dev/null")
        with self.assertRaisesRegex(incise.Error, r"/dev/full/a: cannot be written: Not a directory; when it can, start the sweep again"):
            incise.sweep.write_whole(pathlib.Path("/dev/full/a"), b"")
        self.run_sweep(self.spec(), status=2)
        self.assertIn("accepted is 0 to 79", self.run_sweep(self.spec(), "--sample", "80", status=1))
        self.assertRegex(self.run_sweep(self.spec(), "--out", out, "--dask", "tcp://127.0.0.1:1", status=1),
                         r"\Aincise: [^\n]*no scheduler answers[^\n]*\n\Z")
        self.assertFalse(list(out.glob("shard-*")) if out.exists() else [])


if __name__ == "__main__":
    unittest.main()
