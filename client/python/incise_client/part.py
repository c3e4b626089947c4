"""States whose ids have gaps: the surface, and the part of the volume in a box of interest."""

from __future__ import annotations

from typing import Any, Callable

import numpy as np
import numpy.typing as npt

from .replica import NO_ID, ApplyError, _array, _check_ascending, _Tets
from .state_hash import surface_vertex_hashes, tet_hashes, triangle_hashes, vertex_hashes, xor_of

Ids = npt.NDArray[np.uint32]


class Rows:
    """Arrays with a row for each of ``ids``, which ascend. Never changed in place, so they may be kept."""

    def __init__(self, ids: Any, **columns: Any) -> None:
        self.ids: Ids = np.asarray(ids, np.uint32)
        self.columns: dict[str, Any] = columns
        _check_ascending(self.ids, "elements")
        for name, column in columns.items():
            if len(column) != len(self.ids):
                raise ApplyError(f"{name}: {len(column)} entries for {len(self.ids)} ids")

    def __getattr__(self, name: str) -> Any:
        columns = self.__dict__.get("columns", {})
        if name not in columns:
            raise AttributeError(name)
        return columns[name]

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, where: Any) -> "Rows":
        """The rows at these places, or where a mask is true."""
        return Rows(self.ids[where], **{name: c[where] for name, c in self.columns.items()})

    def among(self, ids: Ids) -> npt.NDArray[np.bool_]:
        """For each row, whether its id is one of these."""
        return np.isin(self.ids, ids)

    def changed(self, put: "Rows", removed: Ids) -> "Rows":
        """A copy with rows put, new or in place of old ones, and others removed. O(rows)."""
        if np.isin(put.ids, removed).any():
            raise ApplyError("elements both removed and set")
        kept = self.take(~self.among(np.concatenate([put.ids, removed])))
        at = np.searchsorted(kept.ids, put.ids)
        return Rows(np.insert(kept.ids, at, put.ids),
                    **{name: np.insert(c, at, put.columns[name], axis=0) for name, c in kept.columns.items()})


def _rows_of(rows: Rows, ids: Ids, what: str) -> npt.NDArray[np.intp]:
    """The rows of these ids, which must all exist."""
    at = np.searchsorted(rows.ids, ids)
    if len(ids) and (not len(rows) or int(at.max()) == len(rows) or (rows.ids[at] != ids).any()):
        raise ApplyError(f"{what} that do not exist")
    return at


class _Held:
    """Base of Surface and VolumePart: vertices, elements with their vertices, a hash."""

    vertices: Rows
    elements: Rows

    def __init__(self) -> None:
        self.revision = 0
        self.hash = 0

    def _element_hashes(self, rows: Rows) -> npt.NDArray[np.uint64]:
        raise NotImplementedError

    def _vertex_hashes(self, rows: Rows) -> npt.NDArray[np.uint64]:
        raise NotImplementedError

    def compute_hash(self) -> int:
        """The hash from scratch. O(all)."""
        return xor_of(self._vertex_hashes(self.vertices)) ^ xor_of(self._element_hashes(self.elements))

    def _change(self, revision: int, hash_after: int, vertices: Rows, gone_vertices: Ids, elements: Rows, gone: Ids,
                finish: Callable[[Rows], Rows] = lambda rows: rows,
                finish_vertices: Callable[[Rows], Rows] = lambda rows: rows) -> None:
        """Makes a change completely or not at all. Hashing costs what changes; the rest copies the arrays."""
        value = self.hash
        for rows, ids, hashes in ((self.vertices, np.concatenate([vertices.ids, gone_vertices]), self._vertex_hashes),
                                  (self.elements, np.concatenate([elements.ids, gone]), self._element_hashes)):
            value ^= xor_of(hashes(rows.take(rows.among(ids))))
        value ^= xor_of(self._vertex_hashes(vertices)) ^ xor_of(self._element_hashes(elements))
        if value != hash_after:
            raise ApplyError(f"revision {revision} has hash {value:016x}, announced was {hash_after:016x}")
        new_vertices = finish_vertices(self.vertices.changed(vertices, gone_vertices))
        new_elements = finish(self.elements.changed(elements, gone))
        _rows_of(new_vertices, np.unique(elements.corners), "vertices of an element")
        self.vertices, self.elements, self.hash, self.revision = new_vertices, new_elements, value, revision

    def _base(self, delta: Any) -> None:
        if delta.BaseRevision() != self.revision or delta.Revision() <= self.revision:
            raise ApplyError(f"delta from {delta.BaseRevision()} to {delta.Revision()}, this state is at {self.revision}")

    def _finish_snapshot(self, begin: Any, chunks: list[Any], end: Any, count: int, announced: int, value: int) -> None:
        if len(chunks) != begin.Chunks() or end.Revision() != begin.Revision():
            raise ApplyError(f"snapshot with {len(chunks)} of {begin.Chunks()} chunks")
        if len(self.vertices) != begin.VertexCount() or count != announced:
            raise ApplyError("snapshot whose counts differ from its contents")
        _rows_of(self.vertices, np.unique(self.elements.corners), "vertices of an element")
        self.revision, self.hash = begin.Revision(), self.compute_hash()
        if self.hash != value:
            raise ApplyError(f"snapshot with hash {self.hash:016x}, announced was {value:016x}")

    def _canonical(self, vertices: list[Any], elements: list[Any]) -> bytes:
        def table(columns: list[Any]) -> bytes:
            parts = [np.ascontiguousarray(c).reshape(len(c), -1) for c in columns]
            raw = [p.view(np.uint8).reshape(len(p), p.shape[1] * p.itemsize) for p in parts]
            return np.concatenate(raw, axis=1).tobytes()

        head = np.array([self.revision, self.hash], np.uint64).tobytes()
        counts = np.array([len(self.vertices), len(self.elements)], np.uint32).tobytes()
        return head + counts + table(vertices) + table(elements)


def _joined(parts: list[Rows], empty: Rows) -> Rows:
    parts = [p for p in parts if len(p)]
    if not parts:
        return empty
    return Rows(np.concatenate([p.ids for p in parts]),
                **{n: np.concatenate([p.columns[n] for p in parts]) for n in empty.columns})


class Surface(_Held):
    """View Surface, or the part of it that touches a box.

    ``vertices``: ids, positions (n, 3) float32, metres, rest (n, 3) float32: where the material is in the body at rest, NaN where that is the
    position. ``elements``: ids (half-faces), corners (m, 3) uint32, counter-clockwise seen from outside, flags (bit 0: cut face), pieces,
    regions, origins (NO_ID: none): the triangle of the surface that the body was filled from (SurfaceAsset).
    """

    def __init__(self) -> None:
        super().__init__()
        self.vertices = self._vertices(None)
        self.elements = self._triangles(None)

    @staticmethod
    def _vertices(table: Any) -> Rows:
        ids = _array(table.IdsAsNumpy(), np.uint32) if table else np.empty(0, np.uint32)
        positions = _array(table.PositionsAsNumpy(), np.float32) if table else np.empty(0, np.float32)
        return Rows(ids, positions=positions.reshape(-1, 3), rest=np.full((len(ids), 3), np.nan, np.float32))

    @staticmethod
    def _rested(vertices: Rows, table: Any) -> Rows:
        """The vertices with these rest positions."""
        if not table or table.IdsLength() == 0:
            return vertices
        at = _rows_of(vertices, _array(table.IdsAsNumpy(), np.uint32), "rest positions of vertices")
        vertices.columns["rest"] = vertices.rest.copy()
        vertices.columns["rest"][at] = _array(table.PositionsAsNumpy(), np.float32).reshape(-1, 3)
        return vertices

    @property
    def rest_corners(self) -> npt.NDArray[np.float32]:
        """Where the corners of each element are in the body at rest: (m, 3, 3), metres."""
        v = self.vertices
        at_rest = np.where(np.isnan(v.rest), v.positions, v.rest)
        return at_rest[np.searchsorted(v.ids, self.elements.corners)]

    @staticmethod
    def _triangles(t: Any) -> Rows:
        if not t:
            return Rows([], corners=np.empty((0, 3), np.uint32), flags=np.empty(0, np.uint8), pieces=np.empty(0, np.uint32),
                        regions=np.empty(0, np.int32), origins=np.empty(0, np.uint32))
        origins = _array(t.OriginsAsNumpy(), np.uint32)
        return Rows(_array(t.IdsAsNumpy(), np.uint32), corners=_array(t.VerticesAsNumpy(), np.uint32).reshape(-1, 3),
                    flags=_array(t.FlagsAsNumpy(), np.uint8), pieces=_array(t.PiecesAsNumpy(), np.uint32),
                    regions=_array(t.RegionsAsNumpy(), np.int32),
                    origins=origins if len(origins) else np.full(t.IdsLength(), NO_ID, np.uint32))

    def _element_hashes(self, rows: Rows) -> npt.NDArray[np.uint64]:
        return triangle_hashes(rows.ids, rows.corners, rows.flags)

    def _vertex_hashes(self, rows: Rows) -> npt.NDArray[np.uint64]:
        return surface_vertex_hashes(rows.ids, rows.positions)

    def canonical_bytes(self) -> bytes:
        """PROTOCOL.md, section 13: equal for equal states."""
        v, t = self.vertices, self.elements
        return self._canonical([v.ids, v.positions], [t.ids, t.corners, t.regions, t.pieces, t.flags.astype(np.uint32)])

    @staticmethod
    def from_snapshot(begin: Any, chunks: list[Any], end: Any) -> "Surface":
        """Built from SnapshotBegin, every SnapshotChunk and SnapshotEnd. Raises ApplyError."""
        new = Surface()
        new.vertices = _joined([Surface._rested(Surface._vertices(c.SurfaceVertices()), c.SurfaceRest()) for c in chunks], new.vertices)
        new.elements = _joined([Surface._triangles(c.Triangles()) for c in chunks], new.elements)
        new._finish_snapshot(begin, chunks, end, len(new.elements), begin.TriangleCount(), end.SurfaceHash())
        return new

    def apply(self, delta: Any) -> None:
        """Takes the state from the SurfaceDelta's base revision to its revision, or raises ApplyError."""
        self._base(delta)
        put = self._vertices(delta.Vertices())
        held = self.vertices.take(self.vertices.among(put.ids))
        put.columns["rest"][np.isin(put.ids, held.ids)] = held.rest  # a vertex that moves keeps what it had
        self._change(delta.Revision(), delta.SurfaceHash(), put,
                     _array(delta.RemovedVerticesAsNumpy(), np.uint32), self._triangles(delta.Triangles()),
                     _array(delta.RemovedTrianglesAsNumpy(), np.uint32),
                     finish_vertices=lambda rows: self._rested(rows, delta.Rest()))


class VolumePart(_Held):
    """The tetrahedra that touch the box of interest, and their vertices.

    ``vertices``: ids, positions (n, 3) float64, metres. ``elements``: ids, corners (m, 4) uint32, regions, cut_masks,
    boundary_masks (bit f for the face opposite to vertex f), pieces.
    """

    def __init__(self) -> None:
        super().__init__()
        self.vertices = Rows([], positions=np.empty((0, 3)))
        self.elements = self._tets(None, np.empty(0, np.uint32))

    @staticmethod
    def _tets(table: Any, pieces: Any) -> Rows:
        t = _Tets(table)
        return Rows(t.ids, corners=t.vertices, regions=t.regions, cut_masks=t.cut_masks, boundary_masks=t.boundary_masks,
                    pieces=pieces)

    def _element_hashes(self, rows: Rows) -> npt.NDArray[np.uint64]:
        return tet_hashes(rows.ids, rows.corners, rows.regions, rows.cut_masks)

    def _vertex_hashes(self, rows: Rows) -> npt.NDArray[np.uint64]:
        return vertex_hashes(rows.ids, rows.positions)

    def canonical_bytes(self) -> bytes:
        """PROTOCOL.md, section 13: equal for equal states."""
        v, t = self.vertices, self.elements
        masks = t.cut_masks + 256 * t.boundary_masks.astype(np.uint32)
        return self._canonical([v.ids, v.positions], [t.ids, t.corners, t.regions, t.pieces, masks])

    @staticmethod
    def from_snapshot(begin: Any, chunks: list[Any], end: Any) -> "VolumePart":
        """Built from SnapshotBegin, every SnapshotChunk and SnapshotEnd. Raises ApplyError."""
        new = VolumePart()
        new.vertices = _joined([Rows(_array(c.VertexIdsAsNumpy(), np.uint32),
                                     positions=_array(c.PositionsAsNumpy(), np.float64).reshape(-1, 3)) for c in chunks],
                               new.vertices)
        new.elements = _joined([VolumePart._tets(c.Tets(), _array(c.TetPiecesAsNumpy(), np.uint32)) for c in chunks],
                               new.elements)
        new._finish_snapshot(begin, chunks, end, len(new.elements), begin.TetCount(), end.PartHash())
        return new

    def apply(self, delta: Any) -> None:
        """Takes the state from the Delta's base revision to its revision, or raises ApplyError."""
        self._base(delta)
        moved = Rows(_array(delta.MovedIdsAsNumpy(), np.uint32),
                     positions=_array(delta.MovedPositionsAsNumpy(), np.float64).reshape(-1, 3))
        added = Rows(_array(delta.AddedIdsAsNumpy(), np.uint32),
                     positions=_array(delta.AddedPositionsAsNumpy(), np.float64).reshape(-1, 3))
        tets = self._tets(delta.Tets(), np.zeros(delta.Tets().IdsLength() if delta.Tets() else 0, np.uint32))
        held = self.elements.take(self.elements.among(tets.ids))
        tets.columns["pieces"][np.isin(tets.ids, held.ids)] = held.pieces  # changed ones stay in their pieces
        piece_tets = _array(delta.PieceTetsAsNumpy(), np.uint32)
        sizes = _array(delta.PieceSizesAsNumpy(), np.uint32)
        if int(sizes.sum()) != len(piece_tets):
            raise ApplyError("delta whose counts differ from its contents")
        pieces = np.repeat(_array(delta.PieceIdsAsNumpy(), np.uint32), sizes)

        def in_pieces(rows: Rows) -> Rows:
            at = _rows_of(rows, piece_tets, "tetrahedra of a piece")
            rows.columns["pieces"] = rows.pieces.copy()
            rows.columns["pieces"][at] = pieces
            return rows

        self._change(delta.Revision(), delta.PartHash(), moved.changed(added, np.empty(0, np.uint32)),
                     _array(delta.RemovedVerticesAsNumpy(), np.uint32), tets,
                     _array(delta.RemovedTetsAsNumpy(), np.uint32), in_pieces)
