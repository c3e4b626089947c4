"""Cuts across the body that an incised serves, and checks the replica against the server's hash: first_client.py [PORT]."""
import sys

import incise_client

port = int(sys.argv[1]) if len(sys.argv) > 1 else 7450
poses = [incise_client.Pose(5_000_000 * i + 1, (-0.06, -0.1 + 0.001 * i, 0.07), buttons=1) for i in range(200)]
with incise_client.connect("127.0.0.1", port, role="operator") as client:
    client.wait_for_revision(0)  # the snapshot is here
    before = client.replica.revision
    client.wait_for_report(client.send_poses(poses))
    client.wait_for_revision(before + 1)
    mesh = client.replica
    print(mesh.revision, mesh.live_tets, mesh.positions.shape, mesh.compute_state_hash() == mesh.state_hash)
