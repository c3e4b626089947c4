"""Cuts a liver in two and draws it: cut_and_plot.py [PICTURE]."""
import sys

import matplotlib

matplotlib.use("Agg")  # draws to a file; leave it out for a window
import matplotlib.pyplot as plt
import numpy as np

import incise

body = incise.Body.phantom("liver", 4_000)
cut = incise.cut(body, [(0, 0.03, -0.1, 0.07), (1, 0.03, 0.1, 0.07)], blade=((0, 0, 0), (0, 0, -0.12)))

session = cut.session
tets, pieces, faces = session.tets(), session.pieces(), session.faces()
piece = pieces[np.searchsorted(tets["id"], faces["tet"])]  # of each face
points = session.positions()
axes = plt.figure(figsize=(6, 4)).add_subplot(projection="3d")
for number in np.unique(piece):
    moved = points + (0.02 * number, 0, 0)  # apart, to see inside
    ours = faces[piece == number]
    for cut_face, colour in ((False, f"C{number}"), (True, "darkred")):
        triangles = ours["vertices"][ours["cut"] == cut_face]
        if len(triangles):
            axes.plot_trisurf(*moved.T, triangles=triangles, color=colour, edgecolor="none")
axes.set_box_aspect(np.ptp(points, axis=0))
axes.set_title(f"{len(np.unique(pieces))} pieces, {cut.report['cut_faces']} cut faces")
plt.savefig(sys.argv[1] if len(sys.argv) > 1 else "cut.png")
print(len(np.unique(pieces)), "pieces,", cut.report["cut_faces"], "cut faces")
