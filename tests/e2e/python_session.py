"""Cuts with the Python client and saves its replica: python_session.py PORT MOTION.csv FILE."""

import csv
import sys

import incise_client
from incise.wire import Role

port, motion, path = int(sys.argv[1]), sys.argv[2], sys.argv[3]
with open(motion, newline="") as rows:
    poses = [
        incise_client.Pose(int(round(1e9 * float(r["t_s"]))) + 1, (float(r["x_m"]), float(r["y_m"]), float(r["z_m"])),
                           buttons=int(r["button"])) for r in csv.DictReader(rows)
    ]
with incise_client.connect("127.0.0.1", port, role=Role.Role.Operator) as client:
    assert client.wait_for_revision(0)
    first = client.replica.revision
    sequence = client.send_poses(poses)
    assert client.wait_for_report(sequence), "the poses were not dealt with"
    assert client.report.Accepted() == len(poses), client.report.Accepted()
    while client.report.BacklogSegments() or client.poll(0.5):
        client.poll(0.1)
    replica = client.replica
    assert replica.revision > first, "nothing was cut"
    assert replica.compute_state_hash() == replica.state_hash
    assert client.resyncs == 0
    with open(path, "wb") as out:
        out.write(replica.canonical_bytes())
    print(replica.revision)
