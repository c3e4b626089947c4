"""Deforms a body in the role simulator, before and after it is cut: python_simulator.py PORT MOTION.csv FILE.

Saves its replica, and prints its revision.
"""

import csv
import sys

import incise_client
import numpy as np
from incise.wire import Role, View

port, motion, path = int(sys.argv[1]), sys.argv[2], sys.argv[3]
patience_s = 60


def swayed(rest: np.ndarray, by: float) -> np.ndarray:
    size = np.ptp(rest[:, 0])
    return rest + np.stack([by * size * (rest[:, 2] / size) ** 2, np.zeros(len(rest)), np.zeros(len(rest))], axis=1)


with incise_client.connect("127.0.0.1", port, role=Role.Role.Simulator, timeout_s=patience_s) as client:
    assert client.wait_for_revision(0, patience_s)
    start = client.replica.positions.copy()
    assert client.replica.rest_positions is client.replica.positions

    # All vertices, as floats.
    wanted = swayed(start, 0.05).astype(np.float32)
    frame = client.send_positions(wanted)
    assert client.wait_for_positions_report(frame, patience_s)
    report = client.positions_report
    assert report.Frame() == frame and report.Taken() == 1 and report.Skipped() == 0
    assert report.Moved() > 0 and report.HeldLength() == 0 and report.PassedOver() == 0
    assert client.wait_for_revision(report.Revision(), patience_s)
    assert np.array_equal(client.replica.positions, wanted.astype(np.float64))
    assert np.array_equal(client.replica.rest_positions, start)

    # Some, as doubles.
    some = np.array([0, 2, 5], np.uint32)
    frame = client.send_positions(client.replica.positions[some] + [1e-5, 0, 0], ids=some)
    assert client.wait_for_positions_report(frame, patience_s)
    assert client.positions_report.Moved() == 3
    assert client.wait_for_revision(client.positions_report.Revision(), patience_s)
    assert np.array_equal(client.replica.positions[some], wanted[some].astype(np.float64) + [1e-5, 0, 0])

    for wrong in (np.zeros((2, 3)), np.zeros(4)):
        try:
            client.send_positions(wrong, ids=[1])
            raise AssertionError("was sent")
        except ValueError:
            pass

    # A cut, and then all vertices there are now.
    with open(motion, newline="") as rows:
        poses = [
            incise_client.Pose(int(round(1e9 * float(r["t_s"]))) + 1, (float(r["x_m"]), float(r["y_m"]), float(r["z_m"])),
                               buttons=int(r["button"])) for r in csv.DictReader(rows)
        ]
    with incise_client.connect("127.0.0.1", port, role=Role.Role.Operator, view=View.View.None_, timeout_s=patience_s) as hand:
        assert hand.wait_for_report(hand.send_poses(poses), patience_s)
        while hand.report.BacklogSegments() or hand.poll(0.5):
            hand.poll(0.1)
    while client.poll(0.5):
        pass
    replica = client.replica
    assert len(replica.positions) > len(start), "nothing was cut"
    assert len(replica.rest_positions) == len(replica.positions)
    # The rest positions are those of the material: swayed again, they are where the vertices are.
    frame = client.send_positions(swayed(replica.rest_positions, 0.03))
    assert client.wait_for_positions_report(frame, patience_s)
    report = client.positions_report
    assert client.wait_for_revision(report.Revision(), patience_s)
    held = report.HeldAsNumpy() if report.HeldLength() else np.empty(0, np.uint32)
    used = np.unique(replica.tets[replica.alive])
    assert report.PassedOver() == len(replica.positions) - len(used)  # those of tetrahedra that are gone
    free = np.setdiff1d(used, held)
    assert len(free) > 0.95 * len(used), len(held)
    assert np.array_equal(replica.positions[free], swayed(replica.rest_positions, 0.03)[free])
    assert replica.compute_state_hash() == replica.state_hash
    assert client.resyncs == 0 and client.snapshots == 1

    # A client that connects now gets the same, including rest positions.
    with incise_client.connect("127.0.0.1", port, timeout_s=patience_s) as late:
        assert late.wait_for_revision(replica.revision, patience_s)
        assert late.replica.canonical_bytes() == replica.canonical_bytes()
        assert np.allclose(late.replica.rest_positions, replica.rest_positions, rtol=0, atol=1e-15)
    with open(path, "wb") as out:
        out.write(replica.canonical_bytes())
    print(replica.revision)
