#!/usr/bin/env python3
"""Checks who includes whom: server/ARCHITECTURE.md's table of the parts, as a program.

    include_rules.py [ROOT]     checks the sources below ROOT (default: this repository); exit 1 on a violation

Every quoted include is a path from the root of the repository, names a file that exists (generated files apart), and
lies in a part that the including part may use. Some parts are also held to certain libraries.
"""
import re
import sys
from pathlib import Path

# A part is the longest of these prefixes that a file's path starts with. A part may always include itself.
# What may be included is a list of parts, or of single files.
BASE = "server/base"  # of the standard library and the system only
CHECK = "server/base/check.hpp"
LARGE_PAGES = "server/base/large_pages.hpp"  # changes no value
STATE_HASH = ["protocol/state_hash.hpp", "protocol/vertex_hashes.hpp"]
TET_FACES = "protocol/tet_faces.hpp"
BLEND = "protocol/blend.hpp"  # how fields are interpolated
NET = "protocol/net"  # connections; the only part of protocol that needs Asio
PUBLISHED_DELTA = "server/stream/published_delta.hpp"  # what the loop hands on, a plain value, too
MIRROR = "server/stream/mirror.hpp"  # the clients' state, without their connections
FEED_LISTENER = "server/stream/feed_listener.hpp"  # hears what viewers are sent
DELTA_ARRAYS = "server/stream/delta_arrays.hpp"
FORCE_SLOT = "server/haptics/force_slot.hpp"  # between the loop and a device's thread
DELTA = ["server/core/mesh/delta.hpp", "server/core/mesh/field.hpp", "server/core/mesh/mesh_data.hpp"]  # plain values, no algorithm
RULES = {
    BASE: [],
    "server/core": [CHECK, LARGE_PAGES, *STATE_HASH, TET_FACES, BLEND],  # and no clock
    "server/mesh_io": [BASE, "server/core"],
    "server/input": [BASE, "server/core", "protocol", NET, FORCE_SLOT],
    "server/haptics": [BASE, "server/core"],
    "server/loop": [BASE, "server/core", "server/input", "server/haptics", "protocol", PUBLISHED_DELTA],
    "server/stream": [BASE, "protocol", NET] + DELTA,
    "server/replay": [BASE, "server/core", "protocol", PUBLISHED_DELTA],
    "server/wasm": [BASE, "server/core", "server/replay", "protocol", MIRROR, DELTA_ARRAYS, PUBLISHED_DELTA],
    "server/cluster": [BASE, "protocol", MIRROR, FEED_LISTENER],
    "server/relay": [BASE, "server/stream", "protocol", NET, "client"] + DELTA,  # a client of another server, and a server of its own
    "server/app": ["server", "client", "protocol"],
    "protocol": [BASE],
    NET: [],
    "client": [BASE, "protocol", NET],
    "tests": ["server", "client", "protocol", NET],
}

# The C++20 library, less what the core must not have: threads, clocks, files and streams, random numbers, and
# containers whose order depends on the platform (server/ARCHITECTURE.md, "Determinism").
CORE_LIBRARY = set(
    """algorithm array bit bitset cassert cctype cerrno cfloat charconv cinttypes climits cmath compare concepts cstdarg
    cstddef cstdint cstdio cstdlib cstring deque exception functional initializer_list iterator limits list map memory
    new numbers numeric optional queue ranges ratio set span sstream stack stdexcept string string_view tuple
    type_traits typeinfo utility valarray variant vector version""".split()
)

# Libraries that only these parts may include, by the beginning of the header's name.
ONLY_IN = {
    "tetgen.h": ["server/mesh_io/tetgen_child"],  # AGPL: in an executable of its own, linked with nothing else of ours
    "boost/": [NET, "server/input", "server/stream", "server/relay", "server/app", "client", "tests"],
    "hidapi": ["server/input", "tests"],
    "igtl": ["tests"],  # the judge of our messages: it must not share our mistakes, nor we its
    "spdlog/": ["server/app", "server/input", "server/loop", "server/stream", "server/relay", "tests"],
    "CLI/": ["server/app", "client/cli", "client/examples", "tests"],
    "pybind11/": ["server/app/python"],
    "nats/": ["server/cluster"],
    "gtest/": ["tests"],
    "benchmark/": ["tests"],
    "flatbuffers/": ["protocol", "tests"],
}

INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]*(?:"([^"]+)"|<([^>]+)>)', re.MULTILINE)
SOURCES = {".hpp", ".cpp", ".h", ".c"}


def below(path, prefixes):
    """Whether path is one of the prefixes or lies in one of them as a folder."""
    return any(path == p or path.startswith(p + "/") for p in prefixes)


def part_of(path):
    """The part that the file belongs to, or None."""
    parts = [part for part in RULES if below(path, [part])]
    return max(parts, key=len, default=None)


def violations(root):
    """Yields a line for each include below root that breaks a rule."""
    files = [f for top in sorted({part.split("/")[0] for part in RULES}) for f in sorted((root / top).rglob("*"))]
    for file in files:
        if file.suffix not in SOURCES or not file.is_file() or "node_modules" in file.parts:
            continue
        name = file.relative_to(root).as_posix()
        part = part_of(name)
        if part is None:
            yield f"{name}: belongs to no part; the parts are {', '.join(RULES)}"
            continue
        text = file.read_text(encoding="utf-8")
        for match in INCLUDE.finditer(text):
            ours, library = match.groups()
            where = f"{name}:{text.count(chr(10), 0, match.start(0)) + 1}"
            if ours:
                generated = ours.endswith("_generated.h") or (root / f"{ours}.in").is_file()
                if not generated and not (root / ours).is_file():
                    yield f'{where}: "{ours}" is no path from the root of the repository'
                elif not below(ours, RULES[part] + [part]):
                    allowed = ", ".join(RULES[part]) or "nothing else of ours"
                    yield f'{where}: {part} may not include "{ours}"; it may include {allowed}'
                continue
            if part == "server/core" and library not in CORE_LIBRARY:
                yield f"{where}: the core may not include <{library}>: no thread, clock, I/O, random number, unordered order"
            for prefix, users in ONLY_IN.items():
                if library.startswith(prefix) and not below(name, users):
                    yield f"{where}: <{library}> belongs in {', '.join(users)}"


def main():
    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).resolve().parents[2])
    found = list(violations(root))
    print("\n".join(found) if found else "include rules hold", file=sys.stderr if found else sys.stdout)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
