#!/usr/bin/python3
"""Makes the README's picture out of Incise's own output: the liver phantom, cut by the demo's motion.

    xvfb-run -a client/pictures/make_pictures.py [BIN]

BIN is the folder with the program `incise` (default: build/release/bin). Needs Debian's python3-vtk9, and xvfb where
there is no display. Writes client/pictures/cut_liver.png.
"""
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SIZE = (1000, 600)
APART_M = 0.014  # how far a piece that was cut off is moved away from the body
TISSUE = (0.68, 0.27, 0.22)
CUT = (1.0, 0.86, 0.74)
INCISION = (0.22, 0.03, 0.04)
LINES = (0.45, 0.16, 0.14)
CUT_LINES = (0.72, 0.45, 0.38)

# The face opposite to vertex f of a tetrahedron, counter-clockwise seen from outside (protocol/PROTOCOL.md).
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


def cut_liver(programs, folder):
    """Cuts the liver phantom as the demo does and returns the cut mesh as a vtkUnstructuredGrid."""
    def incise(*arguments):
        subprocess.run([str(Path(programs) / "incise"), *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)

    capture, cut = folder / "demo.capture", folder / "cut.vtu"
    incise("convert", ROOT / "config/demo_motion.csv", "--config", ROOT / "config/demo.json", "--out", capture)
    incise("export", capture, "--out", cut)
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(cut))
    reader.Update()
    return reader.GetOutput()


def surface_of(grid):
    """Boundary triangles (n, 3), whether each is a cut face (n,), their pieces (n,), and all positions (m, 3)."""
    positions = vtk_to_numpy(grid.GetPoints().GetData()).copy()
    tets = vtk_to_numpy(grid.GetCells().GetConnectivityArray()).reshape(-1, 4)
    mask = vtk_to_numpy(grid.GetCellData().GetArray("cut_mask"))
    piece = vtk_to_numpy(grid.GetCellData().GetArray("piece"))
    triangles = tets[:, FACES].reshape(-1, 3)
    _, where, count = np.unique(np.sort(triangles, axis=1), axis=0, return_inverse=True, return_counts=True)
    boundary = count[where] == 1
    is_cut = ((mask[:, None] >> np.arange(4)) & 1).astype(bool).reshape(-1)
    return triangles[boundary], is_cut[boundary], np.repeat(piece, 4)[boundary], positions


def move_apart(triangles, piece, positions):
    """Moves every piece but the largest away from it, the farther the farther it was, so that all gaps are open."""
    sizes = np.bincount(piece)
    body = sizes.argmax()
    centre = positions[np.unique(triangles[piece == body])].mean(axis=0)
    others = [np.unique(triangles[piece == p]) for p in np.flatnonzero(sizes) if p != body]
    others.sort(key=lambda own: np.linalg.norm(positions[own].mean(axis=0) - centre))
    for rank, own in enumerate(others, start=1):
        away = positions[own].mean(axis=0) - centre
        positions[own] += rank * APART_M * away / np.linalg.norm(away)


def actor(triangles, positions, color, smooth):
    """An actor of one colour; `smooth` shades across edges, as tissue looks, else each facet shows."""
    cells = vtk.vtkCellArray()
    flat = np.hstack([np.full((len(triangles), 1), 3), triangles]).astype(np.int64).ravel()
    cells.SetCells(len(triangles), vtk.util.numpy_support.numpy_to_vtkIdTypeArray(flat, deep=True))
    points = vtk.vtkPoints()
    points.SetData(numpy_to_vtk(positions, deep=True))
    data = vtk.vtkPolyData()
    data.SetPoints(points)
    data.SetPolys(cells)
    mapper = vtk.vtkPolyDataMapper()
    if smooth:
        normals = vtk.vtkPolyDataNormals()
        normals.SetInputData(data)
        normals.SplittingOff()
        mapper.SetInputConnection(normals.GetOutputPort())
    else:
        mapper.SetInputData(data)
    result = vtk.vtkActor()
    result.SetMapper(mapper)
    look = result.GetProperty()
    look.SetColor(*color)
    look.SetAmbient(0.18 if smooth else 0.5)
    look.SetDiffuse(0.85)
    look.SetSpecular(0.25 if smooth else 0.05)
    look.SetSpecularPower(25)
    look.SetEdgeVisibility(True)
    look.SetEdgeColor(*(LINES if smooth else CUT_LINES))
    look.SetLineWidth(1)
    return result


def incision(triangles, is_cut, positions):
    """An actor of the lines where cut faces meet the old surface: a cut that has not opened shows by them."""
    def edges(of):
        return np.sort(of[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)

    skin = {tuple(e) for e in edges(triangles[~is_cut]).tolist()}
    lines = vtk.vtkCellArray()
    for a, b in (e for e in edges(triangles[is_cut]).tolist() if tuple(e) in skin):
        lines.InsertNextCell(2)
        lines.InsertCellPoint(a)
        lines.InsertCellPoint(b)
    points = vtk.vtkPoints()
    points.SetData(numpy_to_vtk(positions, deep=True))
    data = vtk.vtkPolyData()
    data.SetPoints(points)
    data.SetLines(lines)
    mapper = vtk.vtkPolyDataMapper()
    mapper.SetInputData(data)
    mapper.SetResolveCoincidentTopologyToPolygonOffset()
    result = vtk.vtkActor()
    result.SetMapper(mapper)
    result.GetProperty().SetColor(*INCISION)
    result.GetProperty().SetLineWidth(3)
    result.GetProperty().LightingOff()
    return result


def render(actors, path):
    """Renders off-screen on white, from the front, above and to the side, and writes a PNG."""
    renderer = vtk.vtkRenderer()
    renderer.SetBackground(1, 1, 1)
    for a in actors:
        renderer.AddActor(a)
    lights = vtk.vtkLightKit()
    lights.SetKeyLightIntensity(0.95)
    lights.AddLightsToRenderer(renderer)
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(True)
    window.SetMultiSamples(8)
    window.SetSize(*SIZE)
    window.AddRenderer(renderer)
    camera = renderer.GetActiveCamera()
    camera.SetViewUp(0, 0, 1)
    camera.SetPosition(0.34, -0.36, 0.36)
    camera.SetFocalPoint(0, 0, 0)
    camera.SetViewAngle(26)
    renderer.ResetCamera()
    camera.Zoom(1.75)
    renderer.ResetCameraClippingRange()
    window.Render()
    grab = vtk.vtkWindowToImageFilter()
    grab.SetInput(window)
    grab.ReadFrontBufferOff()
    writer = vtk.vtkPNGWriter()
    writer.SetFileName(str(path))
    writer.SetCompressionLevel(9)
    writer.SetInputConnection(grab.GetOutputPort())
    writer.Write()


def main():
    programs = sys.argv[1] if len(sys.argv) > 1 else ROOT / "build/release/bin"
    with tempfile.TemporaryDirectory() as folder:
        grid = cut_liver(programs, Path(folder))
    triangles, is_cut, piece, positions = surface_of(grid)
    move_apart(triangles, piece, positions)
    body = actor(triangles[~is_cut], positions, TISSUE, True)
    faces = actor(triangles[is_cut], positions, CUT, False)
    render([body, faces, incision(triangles, is_cut, positions)], HERE / "cut_liver.png")


if __name__ == "__main__":
    main()
