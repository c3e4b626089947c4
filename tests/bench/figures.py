#!/usr/bin/env python3
"""Prints README's table of headline figures from tests/bench/results/*.csv: a column for each machine."""

import csv
import pathlib
import sys

RESULTS = pathlib.Path(__file__).resolve().parent / "results"

# The label, and where its values are: bench, part of the table's title, part of the row's name, column; then their format.
FIGURES = [
    ("the same corner cut off 16k / 146k / 1.5M tetrahedra, ms", "scale", "the same cut", None, "corner ms", "{:.2f}"),
    ("a cut right through 16k / 146k / 1.5M tetrahedra, ms", "scale", "the same cut", None, "through ms", "{:.1f}"),
    ("VTK's CPU time divided by Incise's (below 1: VTK is faster), the same plane through 15k / 150k tetrahedra", "peers", "", None, "vtk / incise", "{:.2f}"),
    ("random cuts that meet, in three bodies / how many of them left other parts than geometry says", "meet", "by mesh", "all", ("cuts", "wrong"), "{:,.0f}"),
    ("one snap or split, p50, us", "events", "CPU time", "of them", "p50", "{:.1f}"),
    ("20 s of cutting at 1 kHz, 4 viewers, capture: poses lost", "live", "facts", "", "poses lost", "{:.0f}"),
    ("the same: work of a frame, p99.9, ms", "live", "in the server", "frame_work", "p99.9", "{:.2f}", 1e-3),
    ("the same: from a measured pose to its delta at a viewer, p50 / p99, ms", "live", "at the viewers", "measured", ("p50", "p99"), "{:.1f}"),
    ("the same with a simulation that moves all of it 60 times a second, 1 viewer: work of a frame, p99.9, ms", "live_simulated", "in the server", "frame_work", "p99.9", "{:.2f}", 1e-3),
    ("the same: from a pose to its force, p50 / p99, ms", "live_simulated", "in the server", "pose_to_force", ("p50", "p99"), "{:.2f}", 1e-3),
    ("bytes a cut face as deltas of the surface", "stream", "through-cut", "surface, deltas", "bytes a cut face", "{:.0f}"),
]


def read(path: pathlib.Path) -> list[dict[str, str]]:
    with path.open(newline="") as rows:
        return list(csv.DictReader(rows))


def find(rows: list[dict[str, str]], figure: tuple) -> str:
    _, bench, table, name, columns, form, *scale = figure
    values = []
    for column in (columns,) if isinstance(columns, str) else columns:
        values += [float(r["value"]) * (scale[0] if scale else 1) for r in rows
                   if r["bench"] == bench and table in r["table"] and (name is None or name in r["row"]) and r["column"] == column]
    return " / ".join(form.format(value) for value in values) or "-"


def main() -> int:
    machines = {path.stem: read(path) for path in sorted(RESULTS.glob("*.csv"))}
    if not machines:
        return 0
    facts = [{r["column"]: r["value"] for r in rows if r["bench"] == "run"} for rows in machines.values()]
    print("| | " + " | ".join(f["processor"] for f in facts) + " |")
    print("| --- |" + " --- |" * len(machines))
    for figure in FIGURES:
        print(f"| {figure[0]} | " + " | ".join(find(rows, figure) for rows in machines.values()) + " |")
    print("| recorded | " + " | ".join(f"{f['date']}, commit {f['commit']}" for f in facts) + " |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
