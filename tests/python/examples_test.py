"""Runs the programs of client/python/examples and the page's first cut, and builds the wheel: examples_test.py BUILD."""

import os
import pathlib
import re
import subprocess
import sys
import tempfile
import unittest
import zipfile

BUILD = pathlib.Path(sys.argv.pop(1)).resolve()
SOURCE = pathlib.Path(__file__).resolve().parents[2]


class Examples(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name)

    def run_python(self, *arguments, path=BUILD / "python"):
        done = subprocess.run([sys.executable, "-B", *map(str, arguments)], cwd=self.folder, capture_output=True, text=True, timeout=100,
                              env=dict(os.environ, PYTHONPATH=str(path)), check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def run_example(self, name, *arguments):
        return self.run_python(SOURCE / "client/python/examples" / name, *arguments)

    def test_cut_and_plot(self):
        self.assertRegex(self.run_example("cut_and_plot.py", "cut.png"), r"^2 pieces, [1-9]\d* cut faces\n$")
        self.assertTrue((self.folder / "cut.png").read_bytes().startswith(b"\x89PNG"))

    def test_finite_element_step(self):
        self.assertRegex(self.run_example("finite_element_step.py"), r"^[1-9]\d* cut faces; the end hangs \d+\.\d mm, then \d+\.\d mm\n$")

    def test_carry_a_field(self):
        printed = self.run_example("carry_a_field.py").splitlines()
        self.assertEqual(printed[0], "temperature 1 float32, fibre (3,) float32, label 1 int32")
        self.assertRegex(printed[1], r"^[1-9]\d+ new vertices$")
        self.assertLess(float(re.search(r"by (\S+) K", printed[2])[1]), 1e-11)
        self.assertLess(float(re.search(r"by (\S+) K", printed[3])[1]), 1e-3)

    def test_random_cuts(self):
        printed = self.run_example("random_cuts.py")
        self.assertRegex(printed, r"^100 cuts, \d+ leave two pieces, \d+ states\n$")
        self.assertEqual(self.run_example("random_cuts.py"), printed)

    def test_first_cut(self):
        page = (SOURCE / "README.md").read_text()
        program = re.search(r"```python\n(import incise\n.*?)```", page, re.DOTALL)[1]
        self.assertLessEqual(len(program.splitlines()), 5)
        self.assertRegex(self.run_python("-c", program), r"^2 [0-9a-f]{16}\n$")

    def test_wheel(self):
        subprocess.run([sys.executable, "-m", "pip", "wheel", "-q", "--no-build-isolation", "--no-deps", "--no-index", "-w", self.folder,
                        SOURCE / "client/python"], env=dict(os.environ, INCISE_BUILD=str(BUILD)), check=True, timeout=100)
        wheel, = self.folder.glob("incise-*.whl")
        self.assertIn("cp311-cp311-linux", wheel.name)
        with zipfile.ZipFile(wheel) as packed:
            packed.extractall(self.folder / "unpacked")
        for file in ("incise/py.typed", "incise/_core.pyi", "incise_client/py.typed", "incise_client/client.py", "incise/wire/Delta.py"):
            self.assertTrue((self.folder / "unpacked" / file).is_file(), file)
        self.assertFalse((self.folder / "unpacked/incise/incise-tetgen").exists())
        program = ("import incise, incise_client; "
                   f"print(incise.cut('{SOURCE}/tests/replay/body', '{SOURCE}/tests/replay/crossing_conforming.capture').report['state_hash'])")
        self.assertEqual(self.run_python("-c", program, path=self.folder / "unpacked"), self.run_python("-c", program))


if __name__ == "__main__":
    unittest.main()
