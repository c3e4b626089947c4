"""The outline of a host simulation: follows the mesh, sends back where its vertices are now: simulator.py [PORT]."""
import sys

import incise_client


def on_delta(client, delta):
    # Update the solver here. Elements: delta.RemovedTets, delta.Tets. Its fields on the vertices: incise_client.carry().
    # Vertices in delta.RestIds stand for other material than before: client.replica.rest_positions says which.
    print(f"revision {delta.Revision()}: {delta.MovedIdsLength()} vertices moved")


def on_positions_report(client, report):
    # These vertices did not move, or not all the way: they would have inverted an element, or touch the blade.
    print(f"{report.HeldLength()} vertices held")


port = int(sys.argv[1]) if len(sys.argv) > 1 else 7450
with incise_client.connect("127.0.0.1", port, role="simulator") as client:
    client.on_delta = on_delta
    client.on_positions_report = on_positions_report
    for step in range(1, 21):
        if not client.wait_for_revision(0, 30):  # after a reset or an undo the body comes again
            sys.exit("no snapshot came")
        session = client.welcome.Session()
        positions = client.replica.rest_positions * (1 + 0.001 * step, 1, 1)  # of all vertices, or of some, with ids=
        try:
            frame = client.send_positions(positions.astype("float32"))
            answered = client.wait_for_positions_report(frame, 5) and client.wait_for_revision(client.positions_report.Revision(), 5)
        except incise_client.RequestError as error:  # positions of a state that an undo has taken back are refused
            print(error)
            continue
        if not answered and client.welcome.Session() == session:
            sys.exit("the server does not answer")
