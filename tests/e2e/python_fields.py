"""Holds the fields of a body while somebody else cuts it: python_fields.py PORT. Prints "joined", then "ok" once nothing has
changed for a while, then "set" when all have two fields that it has set as a simulator.

The field "rest" is where the material was at rest.
"""

import sys
import time

import numpy as np

import incise_client
from incise.wire import Role

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
    role = Role.Role.Simulator
    with incise_client.connect("127.0.0.1", port, role=role) as simulator:
        assert simulator.wait_for_revision(revision)
        simulator.send_field("heat", 20 + 1000 * simulator.replica.positions[:, 0])
        simulator.send_field("mark", np.full((3, 2), 5), tets=True, first=1)
        for name, values in (("cold", np.zeros(2)), ("heat", np.zeros((2, 2))), ("heat", ["a"])):
            try:
                simulator.send_field(name, values)
                raise AssertionError(name)
            except ValueError as error:
                assert "heat" in str(error), error
        simulator.send_field("heat", np.zeros(10**6))
        deadline = time.monotonic() + 20
        while simulator.error is None and time.monotonic() < deadline:
            simulator.poll(0.1)
        assert "FieldValues: 1000000 floats" in simulator.error.Text().decode(), simulator.error
    set_by_name = []
    client.on_field = lambda _, name: set_by_name.append(name)
    while set(set_by_name) != {"heat", "mark"} and time.monotonic() < deadline:
        client.poll(0.1)
    assert np.abs(client.vertex_fields["heat"] - (20 + 1000 * mesh.positions[:, 0])).max() < 1e-4
    assert (client.tet_fields["mark"][:5] == [[0, 0], [5, 5], [5, 5], [5, 5], [0, 0]]).all()
    print("set", flush=True)
