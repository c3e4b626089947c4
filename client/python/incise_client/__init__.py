"""A client of incised in Python: NumPy arrays of a mesh that is being cut, kept in step over TCP.

Needs NumPy and the flatbuffers package (Debian: python3-numpy, python3-flatbuffers), and the module ``incise.wire`` that the
build makes from ``protocol/incise.fbs``::

    PYTHONPATH=build/release/python /usr/bin/python3 my_program.py

    import incise_client
    with incise_client.connect("127.0.0.1", 7450) as client:
        client.wait_for_revision(10)
        print(client.replica.live_tets, client.replica.positions.mean(axis=0))
"""

try:
    import flatbuffers as _flatbuffers  # noqa: F401
    import numpy as _numpy  # noqa: F401
except ModuleNotFoundError as _error:
    if _error.name not in ("flatbuffers", "numpy"):
        raise
    raise ModuleNotFoundError(f"incise_client needs NumPy and flatbuffers, and {_error.name} is missing: pip install numpy flatbuffers "
                              "(Debian: apt install python3-numpy python3-flatbuffers)", name=_error.name) from None

from .carry import carry, carry_tets
from .client import POSE_DTYPE, Client, Pose, connect
from .contact import ContactRenderer
from .errors import ConnectError, RequestError
from .part import Rows, Surface, VolumePart
from .replica import ApplyError, Replica
from .state_hash import element_hashes, surface_vertex_hashes, tet_hashes, triangle_hashes, vertex_hashes, xor_of
from .surface_asset import SurfaceAsset

__all__ = [
    "ApplyError", "Client", "ConnectError", "ContactRenderer", "POSE_DTYPE", "Pose", "Replica", "RequestError", "Rows", "Surface", "SurfaceAsset",
    "VolumePart", "carry", "carry_tets", "connect", "element_hashes", "surface_vertex_hashes", "tet_hashes", "triangle_hashes", "vertex_hashes", "xor_of",
]
