"""The surface that a body was filled from: its texture coordinates, normals, colours and materials on the cut body."""

from __future__ import annotations

import urllib.request
from typing import Any, Optional

import numpy as np
import numpy.typing as npt

from .part import Surface
from .replica import NO_ID

Floats = npt.NDArray[np.float64]
_MAX_STEPS = 16  # a face spans few triangles


def _barycentric(corners: Floats, points: Floats) -> Floats:
    """Weights (n, 3) of triangles' corners (n, 3, 3) that give the points of their planes nearest to these (n, 3)."""
    ab, ac, ap = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    normal = np.cross(ab, ac)
    area = np.einsum("ij,ij->i", normal, normal)
    b = np.einsum("ij,ij->i", np.cross(ap, ac), normal) / area
    c = np.einsum("ij,ij->i", np.cross(ab, ap), normal) / area
    return np.stack([1 - b - c, b, c], axis=1)


class SurfaceAsset:
    """Arrays of n triangles: ``triangles`` (n, 3) into ``positions`` (v, 3), metres, the body at rest. By corner, or None: ``uvs`` (n, 3, 2),
    ``normals`` (n, 3, 3), ``colours`` (n, 3, 4) uint8. ``material_of`` (n,) into ``materials``, which have ``name``, ``diffuse`` and
    ``texture``, a name below the asset's path.

        asset = SurfaceAsset.fetch("http://127.0.0.1:7480", client.welcome)
        uvs = asset.corner_uvs(client.replica)  # of view Surface: (m, 3, 2): of each triangle's corners; NaN where it has none, as cut faces
    """

    def __init__(self, positions: Any, triangles: Any, uvs: Any = None, normals: Any = None, colours: Any = None,
                 material_of: Any = None, materials: Any = ()) -> None:
        self.positions: Floats = np.asarray(positions, np.float64).reshape(-1, 3)
        self.triangles: npt.NDArray[np.uint32] = np.asarray(triangles, np.uint32).reshape(-1, 3)
        n = len(self.triangles)
        if n and int(self.triangles.max()) >= len(self.positions):
            raise ValueError("triangles: a vertex that does not exist")

        def by_corner(values: Any, size: int, name: str) -> Optional[npt.NDArray[Any]]:
            if values is None or len(values) == 0:
                return None
            array = np.asarray(values)
            if array.size != 3 * n * size:
                raise ValueError(f"{name}: {array.size} entries; accepted are {3 * n * size}")
            return array.reshape(n, 3, size)

        self.uvs, self.normals = by_corner(uvs, 2, "uvs"), by_corner(normals, 3, "normals")
        self.colours = by_corner(colours, 4, "colours")
        self.material_of = None if material_of is None or len(material_of) == 0 else np.asarray(material_of, np.uint32)
        self.materials = list(materials)
        self._beside: Optional[npt.NDArray[np.int64]] = None

    @staticmethod
    def from_bytes(data: bytes) -> "SurfaceAsset":
        """Of the bytes that the server's HTTP port answers. Raises ValueError."""
        from incise.wire.Body import Body
        from incise.wire.Message import Message
        from incise.wire.SurfaceAsset import SurfaceAsset as Wire

        if len(data) < 16 or not Message.MessageBufferHasIdentifier(data, 0):
            raise ValueError("the surface: bytes that are no message of incise")
        message = Message.GetRootAs(data, 0)
        if message.BodyType() != Body.SurfaceAsset:
            raise ValueError("the surface: a message of another kind")
        wire = Wire()
        wire.Init(message.Body().Bytes, message.Body().Pos)

        def array(value: Any) -> Any:
            return [] if isinstance(value, int) else value

        return SurfaceAsset(array(wire.PositionsAsNumpy()), array(wire.TrianglesAsNumpy()), array(wire.UvsAsNumpy()),
                            array(wire.NormalsAsNumpy()), array(wire.ColoursAsNumpy()), array(wire.MaterialIndicesAsNumpy()),
                            [wire.Materials(i) for i in range(wire.MaterialsLength())])

    @staticmethod
    def fetch(server: str, welcome: Any, token: str = "", timeout_s: float = 30) -> "SurfaceAsset":
        """From the HTTP port of the server that sent this Welcome: "http://127.0.0.1:7480". Raises ValueError where the body was not
        filled from a surface, OSError where it cannot be had."""
        facts = welcome.Surface()
        if facts is None or not facts.Path():
            raise ValueError("the server has no surface of this body")
        request = urllib.request.Request(server.rstrip("/") + facts.Path().decode())
        if token:
            request.add_header("Authorization", f"Bearer {token}")
        with urllib.request.urlopen(request, timeout=timeout_s) as answer:
            return SurfaceAsset.from_bytes(answer.read())

    @property
    def corners(self) -> Floats:
        """(n, 3, 3), metres."""
        return self.positions[self.triangles]

    def _neighbours(self) -> npt.NDArray[np.int64]:
        """(n, 3): the triangle across the edge opposite to corner k; -1 where texture coordinates or materials differ there."""
        if self._beside is not None:
            return self._beside
        n = len(self.triangles)
        corner = np.arange(3 * n)
        t, k = corner // 3, corner % 3
        ends = np.stack([self.triangles[t, (k + 1) % 3], self.triangles[t, (k + 2) % 3]], axis=1)
        swap = ends[:, 0] > ends[:, 1]
        ends[swap] = ends[swap][:, ::-1]
        order = np.lexsort((corner, ends[:, 1], ends[:, 0]))
        a, b = order[:-1], order[1:]
        pair = (ends[a] == ends[b]).all(axis=1)
        a, b = a[pair], b[pair]
        if self.material_of is not None:
            same = self.material_of[a // 3] == self.material_of[b // 3]
            a, b = a[same], b[same]
        if self.uvs is not None:
            def uv_of(c: Any) -> Any:  # at the edge's lower and its higher vertex
                one, two = self.uvs[c // 3, (c + 1) % 3], self.uvs[c // 3, (c + 2) % 3]
                return np.where(swap[c][:, None, None], np.stack([two, one], 1), np.stack([one, two], 1))
            same = (uv_of(a) == uv_of(b)).all(axis=(1, 2))
            a, b = a[same], b[same]
        self._beside = np.full((n, 3), -1, np.int64)
        self._beside[a // 3, a % 3] = b // 3
        self._beside[b // 3, b % 3] = a // 3
        return self._beside

    def find(self, origins: Any, points: Any) -> tuple[npt.NDArray[np.int64], Floats]:
        """Where points (n, 3) of the body at rest are on the surface: triangles (n,), and weights (n, 3) of their corners. Each is searched for
        from its origin on, across no seam (PROTOCOL.md, section 5)."""
        at = np.asarray(origins, np.int64).copy()
        points = np.asarray(points, np.float64)
        corners, beside = self.corners, self._neighbours()
        weights = _barycentric(corners[at], points)
        before = np.full(len(at), -2)
        moving = np.arange(len(at))
        for _ in range(_MAX_STEPS):
            least = weights[moving].argmin(axis=1)
            further = beside[at[moving], least]
            go = (weights[moving, least] < 0) & (further >= 0) & (further != before[moving])
            moving, further = moving[go], further[go]
            if not len(moving):
                break
            before[moving], at[moving] = at[moving], further
            weights[moving] = _barycentric(corners[further], points[moving])
        return at, weights

    def at_corners(self, values: Any, surface: Surface) -> Floats:
        """One of ``uvs``, ``normals``, ``colours`` at the corners of each of the surface's triangles: (m, 3, size); NaN where a triangle has no
        origin."""
        if values is None:
            raise ValueError("the surface has no such values")
        origins = surface.elements.origins
        has = origins != NO_ID
        out = np.full((len(origins), 3, values.shape[2]), np.nan)
        at, weights = self.find(np.repeat(origins[has], 3), surface.rest_corners[has].reshape(-1, 3))
        out[has] = np.einsum("ik,ikj->ij", weights, values[at].astype(np.float64)).reshape(-1, 3, values.shape[2])
        return out

    def corner_uvs(self, surface: Surface) -> Floats:
        """Texture coordinates of the corners of each of the surface's triangles: (m, 3, 2)."""
        return self.at_corners(self.uvs, surface)
