#!/usr/bin/env python3
"""Cuts the same meshes in two by the same plane with Incise and with VTK, in one run, and prints one table.

    tests/bench/peers/peers.py [--bin build/release/bin] [--tets 15000,150000] [--mesh FILE.node ...]

VTK's vtkTableBasedClipDataSet is what people use to take a tetrahedral mesh apart along a plane; both halves are made, as
Incise keeps both. It leaves wedges and pyramids where tetrahedra were cut: making tetrahedra of them again
(vtkDataSetTriangleFilter) is timed by itself. Needs Debian's python3-vtk9; Python's own cost is a handful of calls a run.
Times are CPU seconds of the working thread, the best and the median of the repetitions.
"""

import argparse
import json
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import VTK_TETRA, vtkCellArray, vtkPlane, vtkUnstructuredGrid
from vtkmodules.vtkFiltersGeneral import vtkDataSetTriangleFilter, vtkTableBasedClipDataSet

NORMAL = (0.31, 0.17, 1.0)


def read_tetgen(base: pathlib.Path) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and tetrahedra (m, 4) of a .node/.ele pair."""

    def numbers(path: pathlib.Path) -> list[list[str]]:
        lines = (line.split("#")[0].split() for line in path.open())
        return [line for line in lines if line]

    nodes, cells = numbers(base.with_suffix(".node")), numbers(base.with_suffix(".ele"))
    points = np.array([line[1:4] for line in nodes[1:]], dtype=float)
    tets = np.array([line[1:5] for line in cells[1:]], dtype=np.int64) - int(nodes[1][0])
    return points, tets


def worst_dihedral_deg(points: np.ndarray, tets: np.ndarray) -> float:
    """The smallest dihedral angle of all tetrahedra, degrees."""
    p = points[tets]
    faces = [np.cross(p[:, j] - p[:, i], p[:, k] - p[:, i]) for i, j, k in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))]
    lengths = [np.linalg.norm(n, axis=1) for n in faces]
    worst = 180.0
    for i in range(4):
        for j in range(i):
            with np.errstate(invalid="ignore", divide="ignore"):
                cosine = -np.einsum("ij,ij->i", faces[i], faces[j]) / (lengths[i] * lengths[j])
            angles = np.degrees(np.arccos(np.clip(np.abs(np.nan_to_num(cosine, nan=1.0)), 0, 1)))
            obtuse = np.nan_to_num(cosine, nan=1.0) < 0
            worst = min(worst, float(np.where(obtuse, 180 - angles, angles).min()))
    return worst


def grid_of(points: np.ndarray, tets: np.ndarray) -> vtkUnstructuredGrid:
    grid = vtkUnstructuredGrid()
    vtk_points = vtkPoints()
    vtk_points.SetData(numpy_to_vtk(points, deep=True))
    grid.SetPoints(vtk_points)
    cells = vtkCellArray()
    cells.SetData(
        numpy_to_vtkIdTypeArray(np.arange(0, 4 * len(tets) + 1, 4, dtype=np.int64), deep=True),
        numpy_to_vtkIdTypeArray(tets.ravel(), deep=True),
    )
    grid.SetCells(VTK_TETRA, cells)
    return grid


def clip(grid: vtkUnstructuredGrid, plane: vtkPlane) -> tuple[float, list[vtkUnstructuredGrid]]:
    """CPU seconds for both halves, and the halves."""
    halves, spent = [], 0.0
    for inside_out in (False, True):
        filter_ = vtkTableBasedClipDataSet()
        filter_.SetInputData(grid)
        filter_.SetClipFunction(plane)
        filter_.SetInsideOut(inside_out)
        start = time.thread_time()
        filter_.Update()
        spent += time.thread_time() - start
        halves.append(filter_.GetOutput())
    return spent, halves


def tetrahedralize(halves: list[vtkUnstructuredGrid]) -> tuple[float, int, float]:
    """CPU seconds, tetrahedra, and the smallest dihedral angle of them."""
    spent, count, worst = 0.0, 0, 180.0
    for half in halves:
        filter_ = vtkDataSetTriangleFilter()
        filter_.SetInputData(half)
        filter_.TetrahedraOnlyOn()
        start = time.thread_time()
        filter_.Update()
        spent += time.thread_time() - start
        out = filter_.GetOutput()
        tets = vtk_to_numpy(out.GetCells().GetConnectivityArray()).reshape(-1, 4)
        count += len(tets)
        worst = min(worst, worst_dihedral_deg(vtk_to_numpy(out.GetPoints().GetData()).astype(float), tets))
    return spent, count, worst


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bin", type=pathlib.Path, default=pathlib.Path("build/release/bin"))
    parser.add_argument("--tets", default="15000,150000", help="sizes of phantom cylinders to cut")
    parser.add_argument("--mesh", type=pathlib.Path, nargs="*", default=[], help="TetGen meshes to cut instead")
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()

    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        meshes = list(options.mesh)
        if not meshes:
            for size in options.tets.split(","):
                path = pathlib.Path(scratch) / f"cylinder_{size}.node"
                subprocess.run([options.bin / "incise", "phantom", "cylinder", "--size", size, "--out", path], check=True,
                               stdout=subprocess.DEVNULL)
                meshes.append(path)
        for path in meshes:
            ours = json.loads(subprocess.run(
                [options.bin / "incise-bench", "plane", "--json", "--mesh", path, "--repetitions", str(options.repetitions),
                 "--normal", ",".join(map(str, NORMAL))], check=True, stdout=subprocess.PIPE).stdout)["facts"]
            points, tets = read_tetgen(path)
            grid, plane = grid_of(points, tets), vtkPlane()
            plane.SetOrigin(*(0.5 * (points.min(axis=0) + points.max(axis=0))))
            plane.SetNormal(*NORMAL)
            timed = [clip(grid, plane) for _ in range(options.repetitions)]
            vtk_ms = [1e3 * spent for spent, _ in timed]
            again_s, vtk_tets, vtk_angle = tetrahedralize(timed[-1][1])
            rows.append({
                "mesh": path.stem, "tets": len(tets), "angle before": worst_dihedral_deg(points, tets),
                "incise ms": ours["p50 ms"], "best": ours["min ms"],
                "vtk ms": statistics.median(vtk_ms), "best ": min(vtk_ms), "tets again ms": 1e3 * again_s,
                "vtk / incise": statistics.median(vtk_ms) / ours["p50 ms"],
                "incise growth %": 100 * (ours["tets after"] / len(tets) - 1),
                "vtk growth %": 100 * (vtk_tets / len(tets) - 1),
                "incise angle": ours["min dihedral deg"], "vtk angle": vtk_angle,
            })
    if options.json:
        print(json.dumps(rows, indent=2))
        return 0
    texts = [list(rows[0])] + [[v if isinstance(v, str) else f"{v:.3f}" if "angle" in k else f"{v:,}" if isinstance(v, int)
                               else f"{v:.2f}" for k, v in row.items()] for row in rows]
    widths = [max(len(line[i]) for line in texts) for i in range(len(texts[0]))]
    for line in texts:
        print("  ".join(cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in enumerate(zip(line, widths))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
