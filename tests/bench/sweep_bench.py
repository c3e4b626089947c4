#!/usr/bin/env python3
"""What a data set costs: `incise sweep` with one worker and with two, against its samples cut one after the other in one process.

    PYTHONPATH=build/release/python /usr/bin/python3 -B tests/bench/sweep_bench.py [--samples N] [--rounds N] [--json]

Each row is a body: `cut ms` is a sample's incise.cut() in one process, `samples/s` of a sweep that stores states, from its start to its manifest,
`overhead ms` what a sample takes beyond its cut with one worker (files, copies, its share of the start), `efficiency` the rate of two workers
over twice that of one. The shortest of the rounds counts.
"""

import argparse
import json
import pathlib
import subprocess
import tempfile
import time

from incise import sweep

INCISE = pathlib.Path(__file__).resolve().parents[2] / "build/release/bin/incise"
BODIES = [{"phantom": "slab", "tets": 3_000}, {"phantom": "liver", "tets": 30_000}]


def measure(body: dict, samples: int, rounds: int, folder: pathlib.Path) -> dict:
    spec = folder / "spec.json"
    spec.write_text(json.dumps({"bodies": [body], "motions": [{"random_cuts": samples, "seed": 1}],
                                "config": {"blade": {"heel": [0, 0, 0], "tip": [0, 0, -0.12]}}}))
    plan = sweep.read_plan(spec)
    sweep.make_sample(plan, 0, [])  # the body is loaded
    cutting, seconds = [], {1: [], 2: []}
    for number in range(rounds):
        begun = time.perf_counter()
        for sample in range(samples):
            sweep.make_sample(plan, sample, [])
        cutting.append((time.perf_counter() - begun) / samples)
        for workers, found in seconds.items():
            out = folder / f"{body['phantom']}_{number}_{workers}"
            begun = time.perf_counter()
            subprocess.run([INCISE, "sweep", spec, "--out", out, "--workers", str(workers)], check=True, capture_output=True)
            found.append((time.perf_counter() - begun) / samples)
    one, two = min(seconds[1]), min(seconds[2])
    return {"body": f"{body['phantom']} {body['tets']}", "samples": samples, "cut ms": 1e3 * min(cutting), "1 worker, samples/s": 1 / one,
            "2 workers, samples/s": 1 / two, "efficiency": one / (2 * two), "overhead ms": 1e3 * (one - min(cutting))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=400)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = [measure(body, options.samples, options.rounds, pathlib.Path(folder)) for body in BODIES]
    if options.json:
        print(json.dumps(rows, indent=2))
        return
    for row in rows:
        print(", ".join(f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}" for name, value in row.items()))


if __name__ == "__main__":
    main()
