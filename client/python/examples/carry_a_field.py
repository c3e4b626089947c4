"""Carries fields through a cut: a temperature and a fibre direction on the vertices, a label on the tetrahedra."""
import numpy as np

import incise

plain = incise.Body.phantom("liver", 4_000)
points, tets = plain.points, plain.tets
fields = {"temperature": 310 + 20 * points[:, 0], "fibre": np.cross(points, (0, 0, 1))}
body = incise.Body(points, tets, vertex_fields=fields, tet_fields={"label": (points[tets].mean(axis=1)[:, 1] > 0).astype(int)})
sweep = [(0, 0.03, -0.1, 0.07), (1, 0.03, 0.1, 0.07)]

# The session carries the body's own fields, and .vtu files have them.
cut = incise.cut(body, sweep, blade=((0, 0, 0), (0, 0, -0.12)), deltas=True)
carried = cut.session.vertex_fields()
cut.session.save("carried.vtu")
again = incise.Body.load("carried.vtu")
print(", ".join(f"{name} {values.shape[1:] or 1} {values.dtype}" for name, values in (again.vertex_fields | again.tet_fields).items()))

# A field of your own, which no session knows: delta by delta, in double precision.
temperature = fields["temperature"]
for delta in cut.deltas:
    temperature = delta.carry(temperature)
used = np.unique(cut.session.tets()["vertices"])
print(f"{len(cut.session.positions()) - len(points)} new vertices")
print(f"off a linear field by {np.abs(temperature - 310 - 20 * cut.session.positions()[:, 0])[used].max():.0e} K at most")
print(f"off the session's by {np.abs(temperature - carried['temperature'])[used].max():.0e} K at most")
