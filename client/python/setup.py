"""Builds the wheel: CMake makes the packages (server/app/python, client), this copies them.

INCISE_BUILD names a build directory that is up to date; without it CMake builds in build/wheel.
"""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

from setuptools import Distribution, setup
from setuptools.command.build_py import build_py

ROOT = pathlib.Path(__file__).resolve().parents[2]
VERSION = re.search(r"^project\(incise VERSION ([\d.]+)", (ROOT / "CMakeLists.txt").read_text(), re.MULTILINE)[1]
SCRATCH = tempfile.mkdtemp(prefix="incise-wheel-")  # so that nothing is left among the sources


class Build(build_py):
    """Copies what CMake has made, in place of the links to it."""

    def run(self):
        build = os.environ.get("INCISE_BUILD")
        if not build:
            build = ROOT / "build/wheel"
            subprocess.run(["cmake", "-S", ROOT, "-B", build, "-G", "Ninja", "-DCMAKE_BUILD_TYPE=None", "-DCMAKE_CXX_FLAGS=-O2 -g1",
                            "-DINCISE_TESTS=OFF", f"-DPython_EXECUTABLE={sys.executable}"], check=True)
            subprocess.run(["cmake", "--build", build, "--target", "incise_module"], check=True)
        for package in ("incise", "incise_client"):
            # incise-tetgen has another licence (AGPL-3): it comes with the Debian package incise.
            shutil.copytree(pathlib.Path(build) / "python" / package, pathlib.Path(self.build_lib) / package, dirs_exist_ok=True,
                            ignore=shutil.ignore_patterns("__pycache__", "incise-tetgen"))


class Binary(Distribution):
    """Has an extension module, so the wheel is for this Python and machine alone."""

    def has_ext_modules(self):
        return True


try:
    setup(version=VERSION, distclass=Binary, cmdclass={"build_py": Build},
          options={"build": {"build_base": SCRATCH}, "egg_info": {"egg_base": SCRATCH}})
finally:
    shutil.rmtree(SCRATCH, ignore_errors=True)
