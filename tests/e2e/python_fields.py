"""Holds the fields of a body while somebody else cuts it: python_fields.py PORT. Prints "joined", then "ok" once nothing has changed for a while.

The field "rest" is where the material was at rest.
"""

import sys
import time

import numpy as np

import incise_client

port = int(sys.argv[1])
with incise_client.connect("127.0.0.1", port, fields=["*"]) as client:
    assert client.wait_for_revision(0)
    print("joined", flush=True)
    revision, since = 0, time.monotonic()
    while revision == 0 or time.monotonic() - since < 2:
        client.poll(0.1)
        if client.replica.revision != revision:
            revision, since = client.replica.revision, time.monotonic()
    assert client.resyncs == 0
    mesh = client.replica
    used = np.unique(mesh.tets[mesh.alive])
    off = np.abs(client.vertex_fields["rest"][used] - mesh.rest_positions[used]).max()
    assert off < 1e-6, off
    with incise_client.connect("127.0.0.1", port, fields=["rest", "tissue"]) as newcomer:
        assert newcomer.wait_for_revision(revision)
        assert sorted(newcomer.vertex_fields) == ["rest"] and sorted(newcomer.tet_fields) == ["tissue"]
        assert (newcomer.vertex_fields["rest"] == client.vertex_fields["rest"]).all(), "carried otherwise than the server does"
        assert (newcomer.tet_fields["tissue"][mesh.alive] == client.tet_fields["tissue"][mesh.alive]).all()
    assert client.vertex_fields["label"].dtype == np.int32 and (client.vertex_fields["label"] % 7 == 3).all()
    assert client.tet_fields["tissue"][mesh.alive].tolist() == (mesh.regions[mesh.alive] + 10).tolist()
    print("ok", flush=True)
