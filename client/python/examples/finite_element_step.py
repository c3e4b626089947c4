"""A slab that is clamped at one end hangs under its weight, is cut from below and hangs further: linear elasticity on NumPy alone."""
import numpy as np

import incise

YOUNG, POISSON, WEIGHT = 2e5, 0.4, 1e4  # Pa, -, N/m^3
LAME = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
SHEAR = YOUNG / (2 * (1 + POISSON))


def displacement(rest, tets):
    """Displacements, metres, of vertices at `rest` joined by `tets`, with x = 0 clamped: conjugate gradients."""
    corners = rest[tets]
    edges = corners[:, 1:] - corners[:, :1]
    volume = np.linalg.det(edges) / 6
    inner = np.linalg.inv(edges).transpose(0, 2, 1)  # gradients of the shape functions of corners 1 to 3
    gradients = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
    used = np.zeros(len(rest), bool)
    used[tets] = True
    free = (used & (rest[:, 0] > 1e-6))[:, None]

    def scatter(values):  # sums values of corners, (tets, 4, 3), over vertices
        out = np.zeros_like(rest)
        np.add.at(out, tets, values)
        return out * free

    def stiffness(u):  # K u
        slope = np.einsum("tci,tcj->tij", u[tets], gradients)
        strain = (slope + slope.transpose(0, 2, 1)) / 2
        stress = 2 * SHEAR * strain + LAME * np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        return scatter(np.einsum("tij,tcj->tci", stress, gradients) * volume[:, None, None])

    load = np.zeros((len(tets), 4, 3))
    load[:, :, 2] = -WEIGHT * volume[:, None] / 4
    u = np.zeros_like(rest)
    residual = scatter(load)
    direction, size = residual.copy(), (residual**2).sum()
    end = 1e-10 * size
    while size > end:
        image = stiffness(direction)
        step = size / (direction * image).sum()
        u += step * direction
        residual -= step * image
        size, before = (residual**2).sum(), size
        direction = residual + size / before * direction
    return u


def settle(session):
    """Moves the body to where it rests under its weight; returns how far its free end hangs, metres."""
    rest = session.rest_positions()
    u = displacement(rest, session.tets()["vertices"].astype(np.intp))
    held = session.deform(rest + u)[-1].held
    assert len(held) == 0, f"{len(held)} vertices could not follow"
    return -u[:, 2].min()


session = incise.Session(incise.Body.phantom("slab", 1_500), blade=((0, 0, 0), (0, 0, 0.05)))
before = settle(session)
# Across the slab, 4 cm from the clamp, from the lower face up to two thirds of its height; made where the slab hangs now.
middle = np.abs(session.rest_positions()[:, 0] - 0.04) < 0.01
low, high = session.positions()[middle][:, 2].min(), session.positions()[middle][:, 2].max()
tool = low + 0.6 * (high - low) - 0.05
cut = session.cut([(0, 0.04, -0.01, tool), (0.2, 0.04, 0.07, tool)])
after = settle(session)
print(f"{sum(d.cut_faces for d in cut.deltas)} cut faces; the end hangs {1000 * before:.1f} mm, then {1000 * after:.1f} mm")
assert after > 1.05 * before
