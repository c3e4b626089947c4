"""Runs the programs of client/examples against an incised, as the pages that show them say: examples_test.py BUILD."""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

BUILD = pathlib.Path(sys.argv.pop(1)).resolve()
SOURCE = pathlib.Path(__file__).resolve().parents[2]
CONFIG = """{
  "mesh": {"phantom": "liver", "target_tets": 4000},
  "blade": {"heel": [0, 0, 0], "tip": [0, 0, -0.12]},
  "listen": {"tcp_port": 0, "http_port": 0},
  "loop": {"realtime_priority": 0, "lock_memory": false},
  "log": {"level": "warning"}
}"""


class Examples(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        config = pathlib.Path(folder.name) / "session.json"
        config.write_text(CONFIG)
        self.server = subprocess.Popen([BUILD / "bin/incised", "--config", config], stdout=subprocess.PIPE, text=True)
        self.addCleanup(self.stop)
        self.port = None
        for line in self.server.stdout:
            found = re.match(r"listening .*tcp=\S*:(\d+)", line)
            if found:
                self.port = found[1]
                break
        self.assertIsNotNone(self.port, "incised opened no port")

    def stop(self):
        self.server.terminate()
        self.server.wait(20)
        self.server.stdout.close()

    def run_example(self, *command):
        environment = dict(os.environ, PYTHONPATH=f"{SOURCE}/client/python:{BUILD}/python")
        done = subprocess.run([*map(str, command), self.port], cwd=SOURCE, env=environment, capture_output=True, text=True,
                              timeout=90, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def test_first_client(self):
        self.assertRegex(self.run_example(BUILD / "examples/first_client"), r"^[1-9]\d* tetrahedra\n$")

    def test_first_client_in_python(self):
        printed = self.run_example(sys.executable, SOURCE / "client/examples/first_client.py")
        self.assertRegex(printed, r"^[1-9]\d* [1-9]\d* \(\d+, 3\) True\n$")

    def check_simulator(self, printed):
        self.assertEqual(len(re.findall(r"^revision \d+: [1-9]\d* vertices moved$", printed, re.MULTILINE)), 20, printed)
        self.assertIn("0 vertices held", printed)

    def test_simulator(self):
        self.check_simulator(self.run_example(BUILD / "examples/simulator"))

    def test_simulator_in_python(self):
        self.check_simulator(self.run_example(sys.executable, SOURCE / "client/examples/simulator.py"))

    @unittest.skipUnless(shutil.which("umockdev-run"), "umockdev-run is not installed")
    def test_simulated_controller(self):
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([sys.executable, SOURCE / "client/examples/simulated_controller.py", folder], check=True)
            files = [f"{folder}/controller.{ending}" for ending in ("umockdev", "ioctl", "script")]
            done = subprocess.run(["umockdev-run", "-d", files[0], "-i", f"/dev/hidraw0={files[1]}", "-s", f"/dev/hidraw0={files[2]}", "--",
                                   BUILD / "bin/incise", "devices", "--monitor", "--for", "3"],
                                  capture_output=True, text=True, timeout=60, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("1234:abcd", done.stdout)
        self.assertIn("report 1, 14 bytes: 01 00 00 5e 01 00", done.stdout)  # pushed along y
        self.assertRegex(done.stdout, r"of [1-9]\d+ reports: 0 too short, 0 of other numbers, 0 with bad values")

    def test_contact(self):
        printed = self.run_example(BUILD / "examples/contact")
        force = float(re.fullmatch(r"largest force (\d+\.\d+) N\n", printed)[1])
        self.assertGreater(force, 0.01)  # the tool was pressed into the body
        self.assertLessEqual(force, 3.3)


if __name__ == "__main__":
    unittest.main()
