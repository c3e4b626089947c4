"""The state hash of PROTOCOL.md, section 6, for whole arrays at once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

U32 = np.uint32
Words = npt.NDArray[np.uint32]
Hashes = npt.NDArray[np.uint64]


def _rotl(x: Words, n: int) -> Words:
    return (x << U32(n)) | (x >> U32(32 - n))


def _mix(h: Words) -> Words:
    h = (h ^ (h >> U32(16))) * U32(0x85EBCA6B)
    h = (h ^ (h >> U32(13))) * U32(0xC2B2AE35)
    return h ^ (h >> U32(16))


def element_hashes(kind: int, words: Words) -> Hashes:
    """Hashes of n elements of one kind, whose words are the rows of an (n, w) array. O(n w)."""
    n = len(words)
    a = np.full(n, kind * 0x9E3779B1 & 0xFFFFFFFF, U32)
    b = np.full(n, (~kind & 0xFFFFFFFF) * 0x85EBCA77 & 0xFFFFFFFF, U32)
    for w in np.ascontiguousarray(words.T):
        a = _rotl(a ^ (w * U32(0xCC9E2D51)), 13) * U32(5) + U32(0xE6546B64)
        b = _rotl(b ^ (w * U32(0x1B873593)), 17) * U32(9) + U32(0x38495AB5)
    low = _mix(a ^ _rotl(b, 7))
    high = _mix(b + low)
    return (high.astype(np.uint64) << np.uint64(32)) | low.astype(np.uint64)


def vertex_hashes(ids: Words, positions: npt.NDArray[np.float64]) -> Hashes:
    """Hashes of vertices at (n, 3) positions, metres."""
    words = np.empty((len(ids), 7), U32)
    words[:, 0] = ids
    words[:, 1:] = np.ascontiguousarray(positions, np.float64).view(U32)
    return element_hashes(1, words)


def tet_hashes(ids: Words, vertices: Words, regions: npt.NDArray[np.int32],
               cut_masks: npt.NDArray[np.uint8]) -> Hashes:
    """Hashes of tetrahedra with (n, 4) vertices."""
    words = np.empty((len(ids), 7), U32)
    words[:, 0] = ids
    words[:, 1:5] = vertices
    words[:, 5] = np.ascontiguousarray(regions, np.int32).view(U32)
    words[:, 6] = cut_masks
    return element_hashes(2, words)


def triangle_hashes(ids: Words, vertices: Words, flags: npt.NDArray[np.uint8]) -> Hashes:
    """Hashes of boundary triangles with (n, 3) vertices."""
    words = np.empty((len(ids), 5), U32)
    words[:, 0] = ids
    words[:, 1:4] = vertices
    words[:, 4] = flags
    return element_hashes(3, words)


def surface_vertex_hashes(ids: Words, positions: npt.NDArray[np.float32]) -> Hashes:
    """Hashes of vertices of the surface at (n, 3) positions, metres."""
    words = np.empty((len(ids), 4), U32)
    words[:, 0] = ids
    words[:, 1:] = np.ascontiguousarray(positions, np.float32).view(U32)
    return element_hashes(4, words)


def xor_of(hashes: Hashes) -> int:
    """The hash of a set of elements."""
    return int(np.bitwise_xor.reduce(hashes)) if len(hashes) else 0
