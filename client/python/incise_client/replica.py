"""The state that a stream of view Volume describes, as NumPy arrays."""

from __future__ import annotations

from typing import Any, Optional

import numpy as np
import numpy.typing as npt

from .carry import Provenance
from .state_hash import tet_hashes, vertex_hashes, xor_of

NO_ID = 0xFFFFFFFF


class ApplyError(Exception):
    """A message that does not fit the state. The replica is unchanged: ask for a resync."""


def _array(value: Any, dtype: Any) -> Any:
    """An array of a message; FlatBuffers gives 0 for one that is absent."""
    return np.empty(0, dtype) if isinstance(value, int) else value


class _Tets:
    def __init__(self, table: Any) -> None:
        if table is None:
            self.ids = np.empty(0, np.uint32)
            self.vertices = np.empty((0, 4), np.uint32)
            self.regions = np.empty(0, np.int32)
            self.cut_masks = self.boundary_masks = np.empty(0, np.uint8)
            return
        self.ids = _array(table.IdsAsNumpy(), np.uint32)
        self.vertices = _array(table.VerticesAsNumpy(), np.uint32).reshape(-1, 4)
        self.regions = _array(table.RegionsAsNumpy(), np.int32)
        self.cut_masks = _array(table.CutMasksAsNumpy(), np.uint8)
        self.boundary_masks = _array(table.BoundaryMasksAsNumpy(), np.uint8)
        for name in ("vertices", "regions", "cut_masks", "boundary_masks"):
            if len(getattr(self, name)) != len(self.ids):
                raise ApplyError(f"tetrahedra: {name}: {len(getattr(self, name))} entries for {len(self.ids)} ids")
        _check_ascending(self.ids, "tetrahedra")

    def hashes(self) -> npt.NDArray[np.uint64]:
        return tet_hashes(self.ids, self.vertices, self.regions, self.cut_masks)


def _check_ascending(ids: npt.NDArray[np.uint32], what: str) -> None:
    if len(ids) > 1 and not (ids[1:] > ids[:-1]).all():
        raise ApplyError(f"{what}: ids that do not ascend")


class _Delta:
    """The arrays of a MeshDelta, not yet checked against a state."""

    def __init__(self, message: Any) -> None:
        self.message = message
        self.moved = _array(message.MovedIdsAsNumpy(), np.uint32)
        self.moved_to = _array(message.MovedPositionsAsNumpy(), np.float64).reshape(-1, 3)
        self.added = _array(message.AddedPositionsAsNumpy(), np.float64).reshape(-1, 3)
        self.rest = _array(message.RestIdsAsNumpy(), np.uint32)
        self.rest_to = _array(message.RestPositionsAsNumpy(), np.float64).reshape(-1, 3)
        self.tets = _Tets(message.Tets())
        self.changed = self.tets.ids[self.tets.ids < message.FirstNewTet()]
        self.removed = _array(message.RemovedTetsAsNumpy(), np.uint32)
        self.piece_ids = _array(message.PieceIdsAsNumpy(), np.uint32)
        self.piece_names = _array(message.PieceNamesAsNumpy(), np.uint32)


def _parts(tets: npt.NDArray[np.uint32], vertices: int) -> npt.NDArray[np.int64]:
    """For each vertex, the least vertex that it hangs together with. Each round joins what the tetrahedra that still span two
    parts join, so there are about log(tetrahedra) of them."""
    part = np.arange(vertices)
    while True:
        seen = part[tets]
        least = seen.min(axis=1)
        spans = (seen != least[:, None]).any(axis=1)
        if not spans.any():
            return part
        tets, seen, least = tets[spans], seen[spans], np.repeat(least[spans], 4)
        order = np.argsort(-least)  # of assignments to the same place the last stays: the least
        part[seen.ravel()[order]] = least[order]
        while not np.array_equal(further := part[part], part):
            part = further


class Replica:
    """Arrays by id. ``tets[t]`` is all NO_ID where there is no tetrahedron t; ``alive`` says the same.

    positions (n, 3) float64, metres; tets (m, 4) uint32; regions int32; cut_masks and boundary_masks uint8, bit f for the
    face opposite to vertex f. In a body that a simulator deforms, rest_positions says where the material of each
    vertex is at rest; otherwise it equals positions. The arrays are replaced or changed by apply(): copy what you keep.
    """

    def __init__(self) -> None:
        self.revision = 0
        self.state_hash = 0
        self.live_tets = 0
        self.positions = np.empty((0, 3))
        self._rest: Optional[npt.NDArray[np.float64]] = None  # None before the first deformation
        self.piece_names: dict[int, int] = {}
        """A tetrahedron of each piece but 0, by piece. One that is gone: so is the piece."""
        self._pieces: Optional[npt.NDArray[np.uint32]] = None  # None until somebody asks
        self._set_slots(0)

    def _set_slots(self, n: int) -> None:
        self.tets = np.full((n, 4), NO_ID, np.uint32)
        self.regions = np.zeros(n, np.int32)
        self.cut_masks = np.zeros(n, np.uint8)
        self.boundary_masks = np.zeros(n, np.uint8)

    def _grow(self, n: int) -> None:
        more = n - len(self.tets)
        if more <= 0:
            return
        self.tets = np.concatenate([self.tets, np.full((more, 4), NO_ID, np.uint32)])
        for name in ("regions", "cut_masks", "boundary_masks"):
            old = getattr(self, name)
            setattr(self, name, np.concatenate([old, np.zeros(more, old.dtype)]))

    @property
    def rest_positions(self) -> npt.NDArray[np.float64]:
        """(n, 3), metres. Do not change them."""
        return self.positions if self._rest is None else self._rest

    @property
    def alive(self) -> npt.NDArray[np.bool_]:
        """For each id, whether that tetrahedron exists."""
        return self.tets[:, 0] != NO_ID

    @property
    def pieces(self) -> npt.NDArray[np.uint32]:
        """For each id, the piece of that tetrahedron; 0 where there is none. O(mesh) after each change; do not change it."""
        if self._pieces is None:
            tets = self.tets[self.alive]
            part = _parts(tets, len(self.positions))
            piece_of = np.zeros(len(self.positions), np.uint32)
            for piece, tet in sorted(self.piece_names.items()):
                if tet < len(self.tets) and self.tets[tet, 0] != NO_ID:
                    piece_of[part[self.tets[tet, 0]]] = piece
            self._pieces = np.zeros(len(self.tets), np.uint32)
            self._pieces[self.alive] = piece_of[part[tets[:, 0]]]
        return self._pieces

    def boundary_triangles(self) -> npt.NDArray[np.uint32]:
        """Vertices of all boundary faces, (n, 3), counter-clockwise seen from outside."""
        faces = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))
        return np.concatenate([self.tets[(self.boundary_masks >> f & 1).astype(bool)][:, list(faces[f])] for f in range(4)])

    def compute_state_hash(self) -> int:
        """The state hash from scratch. O(mesh)."""
        ids = np.flatnonzero(self.alive).astype(np.uint32)
        return xor_of(vertex_hashes(np.arange(len(self.positions), dtype=np.uint32), self.positions)) ^ xor_of(
            tet_hashes(ids, self.tets[ids], self.regions[ids], self.cut_masks[ids]))

    def canonical_bytes(self) -> bytes:
        """PROTOCOL.md, section 13: equal for equal states."""
        ids = np.flatnonzero(self.alive)
        tets = np.empty((len(ids), 8), np.uint32)
        tets[:, 0] = ids
        tets[:, 1:5] = self.tets[ids]
        tets[:, 5] = self.regions[ids].view(np.uint32)
        tets[:, 6] = self.pieces[ids]
        tets[:, 7] = self.cut_masks[ids] + 256 * self.boundary_masks[ids].astype(np.uint32)
        head = np.array([self.revision, self.state_hash], np.uint64).tobytes()
        counts = np.array([len(self.positions), self.live_tets], np.uint32).tobytes()
        return head + counts + self.positions.tobytes() + tets.tobytes()

    # ---- A snapshot ----

    @staticmethod
    def from_snapshot(begin: Any, chunks: list[Any], end: Any) -> "Replica":
        """Builds a replica from SnapshotBegin, every SnapshotChunk and SnapshotEnd. Raises ApplyError."""
        new = Replica()
        if len(chunks) != begin.Chunks() or end.Revision() != begin.Revision():
            raise ApplyError(f"snapshot with {len(chunks)} of {begin.Chunks()} chunks")
        parts = [_array(c.PositionsAsNumpy(), np.float64).reshape(-1, 3) for c in chunks]
        new.positions = np.concatenate(parts) if parts else np.empty((0, 3))
        rest = [_array(c.RestPositionsAsNumpy(), np.float64).reshape(-1, 3) for c in chunks]
        if any(len(r) for r in rest):
            new._rest = np.concatenate(rest)
            if new._rest.shape != new.positions.shape:
                raise ApplyError("snapshot with rest positions of some of its vertices")
        tets = [_Tets(c.Tets()) for c in chunks]
        last = max((int(t.ids[-1]) for t in tets if len(t.ids)), default=-1)
        new._set_slots(last + 1)
        for t in tets:
            new._put(t)
            new.live_tets += len(t.ids)
        if len(new.positions) != begin.VertexCount() or new.live_tets != begin.TetCount():
            raise ApplyError("snapshot whose counts differ from its contents")
        if last >= 0 and int(new.tets[new.alive].max(initial=0)) >= len(new.positions):
            raise ApplyError("snapshot: a tetrahedron of vertices that do not exist")
        ids, names = _array(begin.PieceIdsAsNumpy(), np.uint32), _array(begin.PieceNamesAsNumpy(), np.uint32)
        if len(ids) != len(names) or (len(names) and (int(names.max()) > last or not new.alive[names].all())):
            raise ApplyError("snapshot: a piece without a tetrahedron")
        new.piece_names = dict(zip(ids.tolist(), names.tolist()))
        new.revision = begin.Revision()
        new.state_hash = new.compute_state_hash()
        if new.state_hash != end.StateHash():
            raise ApplyError(f"snapshot with hash {new.state_hash:016x}, announced was {end.StateHash():016x}")
        return new

    def _put(self, t: _Tets) -> None:
        self.tets[t.ids] = t.vertices
        self.regions[t.ids] = t.regions
        self.cut_masks[t.ids] = t.cut_masks
        self.boundary_masks[t.ids] = t.boundary_masks

    # ---- A delta ----

    def apply(self, delta: Any) -> None:
        """Takes the state from the delta's base revision to its revision, completely or not at all. Raises ApplyError.

        Hashing costs what the delta changes; adding vertices or tetrahedra copies their arrays.
        """
        if delta.BaseRevision() != self.revision or delta.Revision() <= self.revision:
            raise ApplyError(f"delta from {delta.BaseRevision()} to {delta.Revision()}, this state is at {self.revision}")
        new = _Delta(delta)
        self._check_vertices(new)
        live = self._check_tets(new)
        state_hash = self._hash_after(new)
        deforms = any(delta.Steps(i).Stroke() == 0 for i in range(delta.StepsLength()))
        if deforms or self._rest is not None or len(new.rest):
            self._rest = self._rest_after(delta, len(self.positions) + len(new.added))
            self._rest[new.rest] = new.rest_to
        self._change(new)
        self.live_tets = live
        self.state_hash = state_hash
        self.revision = delta.Revision()

    def _check_vertices(self, new: _Delta) -> None:
        old = len(self.positions)
        vertices = old + len(new.added)
        _check_ascending(new.moved, "moved vertices")
        _check_ascending(new.rest, "rest vertices")
        if len(new.rest) != len(new.rest_to) or (len(new.rest) and int(new.rest[-1]) >= vertices):
            raise ApplyError("rest positions of vertices that do not exist")
        if len(new.moved) != len(new.moved_to) or (len(new.moved) and int(new.moved[-1]) >= old):
            raise ApplyError("moved vertices that do not exist")
        if (len(new.added) and new.message.FirstAdded() != old) or new.message.VertexCount() != vertices:
            raise ApplyError("added vertices do not follow the last vertex")
        try:
            Provenance(new.message, old)
        except ValueError as error:
            raise ApplyError(str(error)) from None
        if len(new.tets.ids) and int(new.tets.vertices.max()) >= vertices:
            raise ApplyError("a tetrahedron of vertices that do not exist")

    def _check_tets(self, new: _Delta) -> int:
        """How many tetrahedra there will be."""
        slots = len(self.tets)
        removed, changed = new.removed, new.changed
        _check_ascending(removed, "removed tetrahedra")
        if len(removed) and (int(removed[-1]) >= slots or not self.alive[removed].all()):
            raise ApplyError("removed tetrahedra that do not exist")
        if np.intersect1d(removed, new.tets.ids, assume_unique=True).size:
            raise ApplyError("tetrahedra both changed and removed")
        if new.message.FirstNewTet() < slots or (
                len(changed) and (int(changed[-1]) >= slots or not self.alive[changed].all())):
            raise ApplyError("changed tetrahedra that do not exist")
        elders = _array(new.message.TetEldersAsNumpy(), np.uint32)
        if len(elders) and (len(elders) != len(new.tets.ids) - len(changed) or int(elders.max()) >= slots
                            or not self.alive[elders].all()):
            raise ApplyError("elders that do not exist, or not one for each new tetrahedron")
        live = self.live_tets + len(new.tets.ids) - len(changed) - len(removed)
        if live != new.message.LiveTets() or len(new.piece_names) != len(new.piece_ids):
            raise ApplyError("delta whose counts differ from its contents")
        old = new.piece_names[~np.isin(new.piece_names, new.tets.ids)]
        if len(old) and (int(old.max()) >= slots or not self.alive[old].all() or np.isin(old, removed).any()):
            raise ApplyError("a piece with a tetrahedron that does not exist")
        return live

    def _hash_after(self, new: _Delta) -> int:
        gone = np.concatenate([new.changed, new.removed])
        old = len(self.positions)
        new_ids = np.arange(old, old + len(new.added), dtype=np.uint32)
        state_hash = self.state_hash
        for part in (vertex_hashes(new.moved, self.positions[new.moved]), vertex_hashes(new.moved, new.moved_to),
                     vertex_hashes(new_ids, new.added),
                     tet_hashes(gone, self.tets[gone], self.regions[gone], self.cut_masks[gone]), new.tets.hashes()):
            state_hash ^= xor_of(part)
        announced = new.message.StateHash()
        if state_hash != announced:
            raise ApplyError(
                f"revision {new.message.Revision()} has hash {state_hash:016x}, announced was {announced:016x}")
        return state_hash

    def _slots_after(self, new: _Delta) -> int:
        return max(len(self.tets), int(new.tets.ids[-1]) + 1 if len(new.tets.ids) else 0)

    def _change(self, new: _Delta) -> None:
        if len(new.added):
            self.positions = np.concatenate([self.positions, new.added])
        elif not self.positions.flags.writeable:
            self.positions = self.positions.copy()
        self.positions[new.moved] = new.moved_to
        self._grow(self._slots_after(new))
        self.tets[new.removed] = NO_ID
        for array in (self.regions, self.cut_masks, self.boundary_masks):
            array[new.removed] = 0
        self._put(new.tets)
        self.piece_names.update(zip(new.piece_ids.tolist(), new.piece_names.tolist()))
        self._pieces = None

    def _rest_after(self, delta: Any, vertices: int) -> npt.NDArray[np.float64]:
        """Rest positions with those of added vertices between their parents, which may be added ones too."""
        a, b = delta.ProvenanceAAsNumpy(), delta.ProvenanceBAsNumpy()
        t = _array(delta.ProvenanceTAsNumpy(), np.float64)
        old = len(self.positions)
        rest = np.empty((vertices, 3))
        rest[:old] = self.rest_positions
        if len(t) != vertices - old:
            raise ApplyError("added vertices without provenance")
        for i in range(len(t)):
            rest[old + i] = rest[a[i]] + t[i] * (rest[b[i]] - rest[a[i]])
        return rest
