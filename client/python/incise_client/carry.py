"""Fields that a client carries on the vertices of view Volume, over a delta."""

from __future__ import annotations

from typing import Any, Iterator

import numpy as np
import numpy.typing as npt


class Provenance:
    """Where the vertices of a delta come from: its lists, checked against the ``vertices`` that were there before.

    Raises ValueError. O(delta).
    """

    def __init__(self, delta: Any, vertices: int) -> None:
        def array(name: str, dtype: Any) -> Any:
            value = getattr(delta, name + "AsNumpy")()
            return np.empty(0, dtype) if isinstance(value, int) else value  # FlatBuffers gives 0 for one that is absent

        self.vertices = vertices
        self.a, self.b, self.t = array("ProvenanceA", np.uint32), array("ProvenanceB", np.uint32), array("ProvenanceT", np.float64)
        self.ids, self.from_ = array("BlendIds", np.uint32), array("BlendVertices", np.uint32)
        self.weights = array("BlendWeights", np.float64)
        added, blends = array("RoundAdded", np.uint32), array("RoundBlends", np.uint32)
        if not len(added) and not len(blends):
            added, blends = np.array([len(self.t)]), np.array([len(self.ids)])
        if (len(self.a) != len(self.t) or len(self.b) != len(self.t) or len(self.from_) != 4 * len(self.ids)
                or len(self.weights) != 4 * len(self.ids) or len(added) != len(blends)):
            raise ValueError("provenance or blends of different lengths")
        if int(added.sum()) != len(self.t) or int(blends.sum()) != len(self.ids):
            raise ValueError("rounds that do not add up to the delta's added vertices and blends")
        self.from_, self.weights = self.from_.reshape(-1, 4), self.weights.reshape(-1, 4)
        new = vertices + np.arange(len(self.t))
        if (self.a >= new).any() or (self.b >= new).any():
            raise ValueError("a vertex made of later ones")
        self._added, self._blends = [int(n) for n in added], [int(n) for n in blends]
        for before, after, blended, _ in self.rounds():
            ids = self.ids[blended]
            if len(ids) and (int(ids[-1]) >= after or (ids[1:] <= ids[:-1]).any() or int(self.from_[blended].max()) >= before):
                raise ValueError("blends of vertices that do not exist, or out of order")

    def rounds(self) -> Iterator[tuple[int, int, slice, slice]]:
        """For each: how many vertices there are before and after it, its blends, its added vertices."""
        added = blends = 0
        for more_added, more_blends in zip(self._added, self._blends):
            yield (self.vertices + added, self.vertices + added + more_added, slice(blends, blends + more_blends),
                   slice(added, added + more_added))
            added, blends = added + more_added, blends + more_blends


def _rows(values: npt.ArrayLike) -> npt.NDArray[Any]:
    if np.ma.is_masked(values):
        raise ValueError("values: found an array with masked numbers; accepted are arrays in which all numbers count")
    return np.asarray(values)


def carry_tets(delta: Any, values: npt.ArrayLike) -> npt.NDArray[Any]:
    """The same for a field on the tetrahedra: ``values`` has a row for each id, as ``Replica.tets``.

    A new tetrahedron has what its elder has, the one in whose place it is; rows of ids without a tetrahedron are meaningless.
    Raises ValueError. O(tetrahedra), for the copy.
    """
    values = _rows(values)
    elders, tets = delta.TetEldersAsNumpy(), delta.Tets()
    if isinstance(elders, int):
        return values.copy()
    ids = tets.IdsAsNumpy()[-len(elders):] if tets is not None else elders[:0]
    if len(ids) != len(elders) or (ids < len(values)).any() or (ids[1:] <= ids[:-1]).any() or (elders >= len(values)).any():
        raise ValueError("carry_tets: new tetrahedra and elders do not fit the values")
    out = np.zeros((int(ids[-1]) + 1,) + values.shape[1:], values.dtype)
    out[:len(values)] = values
    out[ids] = values[elders]
    return out


def carry(delta: Any, values: npt.ArrayLike) -> npt.NDArray[Any]:
    """The values of a field on the vertices at ``delta.Revision()``, from ``values``, those at ``delta.BaseRevision()``.

    ``values`` is (vertices,) or (vertices, ...), of any number type; the result has the same type. Numbers with a fraction are
    interpolated (in double precision); a whole number is that of the vertex with the largest weight. ``delta`` is a message of
    view Volume without a box, as ``on_delta`` gets it. Raises ValueError where values or lists do not fit. O(vertices), for
    the copy.
    """
    values = _rows(values)
    provenance = Provenance(delta, delta.VertexCount() - delta.AddedPositionsLength() // 3)
    if values.ndim < 1 or len(values) != provenance.vertices:
        raise ValueError(f"carry: found an array of shape {values.shape}, expected one row for each of "
                         f"{provenance.vertices} vertices")
    nearest = values.dtype.kind in "iub"
    if not nearest and values.dtype.kind != "f":
        raise ValueError(f"carry: found values of type {values.dtype}, accepted are integers and floating-point numbers")
    out = np.empty((delta.VertexCount(),) + values.shape[1:], values.dtype)
    out[:len(values)] = values

    def blend(vertices: npt.NDArray[Any], weights: npt.NDArray[Any]) -> Any:
        if nearest:
            return out[vertices[np.arange(len(vertices)), weights.argmax(axis=1)]]
        return np.einsum("ij,ij...->i...", weights, out[vertices].astype(np.float64))

    for before, _, blended, added in provenance.rounds():
        ids = provenance.ids[blended]
        if len(ids):
            out[ids] = blend(provenance.from_[blended], provenance.weights[blended])
        parents = np.column_stack([provenance.a[added], provenance.b[added]])
        weights = np.column_stack([1 - provenance.t[added], provenance.t[added]])
        for i in np.flatnonzero(~np.isin(np.arange(len(parents)) + before, ids)):  # in order: parents may be added ones
            out[before + i] = blend(parents[i:i + 1], weights[i:i + 1])[0]
    return out
