#!/usr/bin/env python3
"""Figures as data: what ./dev bench --record and ./dev bench --compare REF run.

    record.py record                     runs SET and writes tests/bench/results/MACHINE.csv
    record.py compare REF [--rounds N]   builds REF in a second tree, runs PAIRED in both in turn, prints ratios

A result is a CSV file with the columns bench, table, row, column, value; its first rows (bench `run`) say which commit, compiler and
processor. README's table of figures is made from these files by figures.py.
"""

import argparse
import csv
import json
import os
import pathlib
import re
import statistics
import subprocess
import sys
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
RESULTS = ROOT / "tests/bench/results"
BIN = ROOT / "build/release/bin"

# Phantoms only, so that every machine runs the same.
SET = {
    "paper": ["paper", "--phantom", "--repetitions", "50"],
    "scale": ["scale", "--tets", "15000,150000,1500000"],
    "events": ["events"],
    "cut": ["cut", "--cuts", "20"],
    "live": ["live", "--seconds", "20"],
    "live_simulated": ["live", "--seconds", "20", "--viewers", "1", "--simulate", "60"],
    "stream": ["stream", "--rounds", "1"],
    "meet": ["meet", "--count", "23"],  # of each kind, in three bodies
}
# Programs beside incise-bench that print a list of rows: bench, the columns that name a row, command.
SCRIPTS = [
    ("peers", ["mesh"], ["/usr/bin/python3", "-B", "tests/bench/peers/peers.py", "--bin", str(BIN), "--json"]),
    ("sweep", ["body"], ["/usr/bin/python3", "-B", "tests/bench/sweep_bench.py", "--json"]),
    ("wasm", ["tets", "cut"], ["node", "tests/bench/wasm_ratio.mjs", "--json"]),
]
PAIRED = {
    "paper": ["paper", "--phantom", "--repetitions", "50"],
    "scale": ["scale", "--tets", "15000,150000"],
    "cut": ["cut", "--cuts", "5"],
}

Row = tuple[str, str, str, str, str]  # bench, table, row, column, value


def say(text: str) -> None:
    print(f"dev: {text}", file=sys.stderr, flush=True)


def rows_of(bench: str, output: str) -> list[Row]:
    """The figures that incise-bench --json printed."""
    data = json.loads(output)
    rows = [(bench, "facts", "", name, str(value)) for name, value in data["facts"].items()]
    for table, lines in data["tables"].items():
        # Rows of one name (the same mesh in several shapes) are told apart by their texts.
        for line in lines:
            name = " ".join(str(v) for i, v in enumerate(line.values()) if i == 0 or isinstance(v, str))
            if "segments" in line:
                name += f" {line['segments']}"
            rows += [(bench, table, name, column.strip(), str(value)) for column, value in list(line.items())[1:]]
    return rows


def run(bin_: pathlib.Path, bench: str, arguments: list[str]) -> list[Row]:
    environment = {k: v for k, v in os.environ.items() if k != "INCISE_DATA"}
    done = subprocess.run([bin_ / "incise-bench", "--json", *arguments], env=environment, stdout=subprocess.PIPE, text=True,
                          check=True)
    return rows_of(bench, done.stdout)


def first_line(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.partition("\n")[0]


def processor() -> str:
    for line in pathlib.Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return "unknown processor"


def record() -> int:
    cpu = processor()
    rows: list[Row] = [
        ("run", "", "", "date", time.strftime("%Y-%m-%d")),
        ("run", "", "", "commit", first_line("git", "-C", str(ROOT), "describe", "--always", "--dirty", "--exclude", "*")),
        ("run", "", "", "compiler", first_line("g++", "--version")),
        ("run", "", "", "processor", f"{cpu}, {os.cpu_count()} used"),
        ("run", "", "", "load before", f"{os.getloadavg()[0]:.2f}"),
    ]
    for bench, arguments in SET.items():
        say(f"incise-bench {' '.join(arguments)}")
        rows += run(BIN, bench, arguments)
    for bench, names, command in SCRIPTS:
        say(" ".join(command))
        printed = subprocess.run(command, cwd=ROOT, env=dict(os.environ, PYTHONPATH="build/release/python"), stdout=subprocess.PIPE, text=True,
                                 check=True).stdout
        for line in json.loads(printed):
            row = " ".join(str(line.pop(name)) for name in names)
            rows += [(bench, "", row, column.strip(), str(value)) for column, value in line.items()]
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / (re.sub(r"[^a-z0-9]+", "_", cpu.lower()).strip("_") + f"_x{os.cpu_count()}.csv")
    with path.open("w", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(["bench", "table", "row", "column", "value"])
        writer.writerows(rows)
    subprocess.run([sys.executable, "-B", ROOT / "tests/dev/docs.py", "--write"], check=True)
    say(f"wrote {path.relative_to(ROOT)} and the figures in README.md")
    return 0


def build_beside(ref: str) -> pathlib.Path:
    """incise-bench of another commit, in a work tree of its own below build/."""
    commit = first_line("git", "-C", str(ROOT), "rev-parse", "--verify", f"{ref}^{{commit}}")
    if not commit:
        sys.exit(f"dev: {ref} is no commit of this repository")
    tree = ROOT / "build/compare" / commit[:12]
    if not tree.exists():
        subprocess.run(["git", "-C", ROOT, "worktree", "add", "--quiet", "--detach", tree, commit], check=True)
    say(f"building incise-bench of {commit[:12]}")
    with (ROOT / "build/compare/build.log").open("w") as log:
        for command in (["cmake", "--preset", "release", "-DINCISE_VIEWER=OFF"], ["ninja", "-C", "build/release", "incise-bench", "incised"]):
            if subprocess.run(command, cwd=tree, stdout=log, stderr=log, check=False).returncode:
                sys.exit("dev: it could not be built; see build/compare/build.log")
    return tree / "build/release/bin"


def is_time(column: str) -> bool:
    return bool(re.search(r"\b(ms|us|ns)\b", column))


def compare(ref: str, rounds: int) -> int:
    other = build_beside(ref)
    say(f"{rounds} rounds, {ref} and this tree in turn")
    ratios: dict[tuple[str, ...], list[float]] = {}
    counted: set[tuple[str, ...]] = set()
    changed: dict[tuple[str, ...], tuple[str, str]] = {}
    for _ in range(rounds):
        for bench, arguments in PAIRED.items():
            theirs = {row[:4]: row[4] for row in run(other, bench, arguments)}
            ours = {row[:4]: row[4] for row in run(BIN, bench, arguments)}
            for key in theirs.keys() & ours.keys():
                if is_time(key[3]):
                    if float(theirs[key]) > 0:
                        ratios.setdefault(key, []).append(float(ours[key]) / float(theirs[key]))
                elif key[3] not in ("to the first", "paper / p50"):
                    counted.add(key)
                    if theirs[key] != ours[key]:
                        changed[key] = (theirs[key], ours[key])
    print(f"times, this tree / {ref}, median of {rounds} rounds (least to largest)")
    for key, values in sorted(ratios.items()):
        print(f"  {statistics.median(values):6.3f}  ({min(values):.3f} to {max(values):.3f})  {' | '.join(filter(None, key))}")
    if ratios:
        everything = [statistics.median(values) for values in ratios.values()]
        print(f"  {statistics.median(everything):6.3f}  the median of all")
    print(f"counted and measured results: {len(changed)} of {len(counted)} differ")
    for key, (a, b) in sorted(changed.items()):
        print(f"  {a} -> {b}  {' | '.join(filter(None, key))}")
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("record")
    pair = commands.add_parser("compare")
    pair.add_argument("ref", metavar="REF")
    pair.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    return record() if options.command == "record" else compare(options.ref, options.rounds)


if __name__ == "__main__":
    sys.exit(main())
