#!/usr/bin/env python3
"""include_rules.py accepts a tree that keeps the rules and names the line that breaks each kind of rule."""
import tempfile
import unittest
from pathlib import Path

import include_rules

GOOD = {
    "protocol/state_hash.hpp": "#pragma once\n#include <cstdint>\n",
    "protocol/replica.hpp": '#pragma once\n#include "protocol/state_hash.hpp"\n#include "protocol/incise_generated.h"\n',
    "server/core/mesh.hpp": '#pragma once\n#include <vector>\n#include "protocol/state_hash.hpp"\n',
    "server/mesh_io/read.cpp": '#include "server/core/mesh.hpp"\n#include <fstream>\n',
    "server/mesh_io/tetgen_child/main.cpp": "#include <tetgen.h>\n",
    "client/client.cpp": '#include "protocol/replica.hpp"\n  #  include <boost/asio.hpp>\n',
    "tests/core/mesh_test.cpp": '#include <gtest/gtest.h>\n\n#include "server/core/mesh.hpp"\n',
}


class IncludeRules(unittest.TestCase):
    def violations(self, files):
        with tempfile.TemporaryDirectory() as root:
            for name, text in {**GOOD, **files}.items():
                file = Path(root, name)
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(text, encoding="utf-8")
            return list(include_rules.violations(Path(root)))

    def test_accepts_what_keeps_them(self):
        self.assertEqual(self.violations({}), [])

    def refuses(self, name, text, message):
        found = self.violations({name: text})
        self.assertEqual(len(found), 1, found)
        self.assertIn(message, found[0])

    def test_the_core_includes_only_the_state_hash(self):
        self.refuses("server/core/a.cpp", '\n#include "protocol/replica.hpp"\n', "server/core/a.cpp:2: server/core may not")

    def test_the_core_has_no_thread_clock_or_stream(self):
        for header in ["thread", "chrono", "iostream", "random", "unordered_map", "unistd.h", "boost/crc.hpp"]:
            files = {"server/core/a.cpp": f"#include <{header}>\n"}
            self.assertTrue(any("the core may not include" in line for line in self.violations(files)), header)

    def test_a_client_never_includes_the_server(self):
        self.refuses("client/a.cpp", '#include "server/core/mesh.hpp"\n', "client may not include")

    def test_the_protocol_stands_alone(self):
        self.refuses("protocol/a.hpp", '#include "server/core/mesh.hpp"\n', "protocol may not include")

    def test_nothing_includes_a_test(self):
        self.refuses("server/mesh_io/a.cpp", '#include "tests/core/mesh_test.cpp"\n', "server/mesh_io may not include")

    def test_tetgen_stays_in_its_own_program(self):
        self.refuses("server/mesh_io/a.cpp", "#include <tetgen.h>\n", "belongs in server/mesh_io/tetgen_child")

    def test_an_include_is_a_path_from_the_root(self):
        self.refuses("server/core/a.cpp", '#include "mesh.hpp"\n', "is no path from the root")

    def test_every_source_belongs_to_a_part(self):
        self.refuses("server/extra/a.cpp", "", "belongs to no part")

    def test_a_part_is_a_folder_not_a_prefix(self):
        self.refuses("server/corex/a.hpp", "", "belongs to no part")


if __name__ == "__main__":
    unittest.main()
