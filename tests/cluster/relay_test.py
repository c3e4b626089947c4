"""Relays that NATS feeds: viewers at them have the server's state, whatever becomes of NATS, the server or the relay."""

import json
import os
import signal
import subprocess
import threading
import time

import incise_client
from harness import BIN, ClusterTest, main, send_admin, stroke, wait_for
from incise.wire import Body


class Relay:
    """incise-relay of a session; `source` says where from, e.g. ["--to", "HOST:PORT"]. It keeps its ports."""

    def __init__(self, folder, source, name="relay"):
        self.folder, self.name, self.source, self.ports = folder, name, [str(word) for word in source], (0, 0)
        self.process = None

    def start(self, wait=True):
        self.log_file = open(self.folder / f"{self.name}.log", "a")
        self.process = subprocess.Popen([BIN / "incise-relay", *self.source, "--port", str(self.ports[0]), "--http-port",
                                         str(self.ports[1])], stdout=subprocess.PIPE, stderr=self.log_file)
        os.set_blocking(self.process.stdout.fileno(), False)
        self.pending = ""
        if wait:
            wait_for("the relay listens: " + self.log(), self.listens)
        return self

    def listens(self):
        self.pending += (self.process.stdout.read() or b"").decode()
        if "listening " not in self.pending:
            assert self.process.poll() is None, self.log()
            return False
        words = dict(w.split("=", 1) for w in self.pending.split("\n")[0].split()[1:])
        self.tcp, self.http = self.ports = tuple(int(words[k].rsplit(":", 1)[1]) for k in ("tcp", "http"))
        return True

    def log(self):
        return (self.folder / f"{self.name}.log").read_text()

    def signal(self, number):
        self.process.send_signal(number)

    def kill(self):
        if self.process and self.process.poll() is None:
            self.process.kill()
        if self.process:
            self.process.wait()
            self.process.stdout.close()
            self.log_file.close()


class Viewer:
    """A viewer that stays; it notes whether a revision of the same epoch ever went back."""

    def __init__(self, port):
        self.client = incise_client.connect("127.0.0.1", port, role=0)
        self.last = (0, 0)
        self.went_back = False

    def follow(self):
        while self.client.poll(0.02):
            self.note()
        self.note()

    def note(self):
        if not self.client.snapshots_or_resumed:
            return
        now = (self.client.welcome.Session(), self.client.replica.revision)
        self.went_back = self.went_back or (now[0] == self.last[0] and now[1] < self.last[1])
        self.last = now

    def is_at(self, server):
        self.follow()
        state = server.stats()
        replica = self.client.replica
        return (self.client.snapshots_or_resumed and replica.revision == state["revision"]
                and replica.compute_state_hash() == int(state["state_hash"], 16))


class RelayTest(ClusterTest):
    def relay(self, nats, session="liver"):
        self.started.append(Relay(self.folder, ["--nats", nats.url, "--session", session]))
        return self.started[-1]

    def set_up(self, **options):
        nats = self.nats()
        server = self.incised({"nats": nats.url, "name": "liver"}, **options)
        server.start()
        relay = self.relay(nats).start()
        return nats, server, relay

    def viewer(self, relay):
        viewer = Viewer(relay.tcp)
        self.addCleanup(viewer.client.close)
        return viewer

    def assert_there(self, viewer, server, relay):
        wait_for("the viewer comes to the server's state: " + relay.log(), lambda: viewer.is_at(server))

    def test_viewers_follow(self):
        _, server, relay = self.set_up(capture=self.folder / "session.capture")
        viewer = self.viewer(relay)
        stroke(server, 2)
        self.assert_there(viewer, server, relay)
        self.assertFalse(viewer.went_back)
        self.assertEqual(viewer.client.snapshots, 1, "deltas, not snapshots")
        epoch = viewer.last[0]
        send_admin(server, Body.Body.Undo)
        wait_for("the stroke is undone", lambda: viewer.follow() or viewer.last[0] != epoch)
        self.assert_there(viewer, server, relay)
        send_admin(server, Body.Body.Reset)
        wait_for("it was reset", lambda: server.stats()["revision"] == 0)
        stroke(server)
        self.assert_there(viewer, server, relay)
        # One that comes later, and one that the relay is listed for.
        self.assert_there(self.viewer(relay), server, relay)
        places = wait_for("the relay is listed", lambda: [p for s in json.loads(server.get("/sessions")) for p in s["places"]
                                                          if p["kind"] == "relay"])
        self.assertEqual(places[0]["tcp"], f"tcp://127.0.0.1:{relay.tcp}")

    def test_an_operator_at_the_relay_cuts_at_the_server(self):
        _, server, relay = self.set_up()
        viewer = self.viewer(relay)
        relay.stats = server.stats
        wait_for("the relay knows the server", lambda: json.loads(server.get("/sessions")))
        time.sleep(4)  # the relay's list of servers is as old as three seconds
        self.assertGreater(stroke(relay), 0)
        self.assert_there(viewer, server, relay)

    def test_nats_is_killed_stopped_and_back(self):
        nats, server, relay = self.set_up()
        viewer = self.viewer(relay)
        stroke(server)
        self.assert_there(viewer, server, relay)
        nats.kill()
        stroke(server, 2, offset=0.5)
        viewer.follow()
        nats.start()
        self.assert_there(viewer, server, relay)
        nats.pause()
        stroke(server, offset=0.6)
        time.sleep(1)
        nats.go_on()
        self.assert_there(viewer, server, relay)
        self.assertFalse(viewer.went_back)

    def test_the_server_is_killed_and_resumed(self):
        nats, server, relay = self.set_up(capture=self.folder / "session.capture")
        viewer = self.viewer(relay)
        stroke(server)
        self.assert_there(viewer, server, relay)
        epoch = viewer.last[0]
        server.kill()
        wait_for("the relay says so", lambda: viewer.follow() or "is silent" in relay.log())
        server.start("--resume")
        stroke(server, offset=0.6)
        self.assert_there(viewer, server, relay)
        self.assertEqual(viewer.last[0], epoch)
        self.assertFalse(viewer.went_back)

    def test_the_relay_stands_still_and_is_killed(self):
        nats, server, relay = self.set_up()
        viewer = self.viewer(relay)
        relay.signal(signal.SIGSTOP)
        stroke(server, 3)
        relay.signal(signal.SIGCONT)
        self.assert_there(viewer, server, relay)
        relay.kill()
        stroke(server, offset=0.7)
        relay.start()
        self.assert_there(self.viewer(relay), server, relay)

    def test_a_viewer_that_is_ahead_of_a_relay_waits_for_it(self):
        nats, server, relay = self.set_up()
        ahead = self.viewer(relay)
        stroke(server)
        self.assert_there(ahead, server, relay)
        # At the server it sees what NATS, which stands still, has not given to the relay.
        nats.pause()
        client = incise_client.connect("127.0.0.1", server.tcp, role=0, resume=ahead.client)
        self.addCleanup(client.close)
        revision = stroke(server, offset=0.6)
        self.assertTrue(client.wait_for_revision(revision))
        threading.Timer(1.5, nats.go_on).start()
        back = incise_client.connect("127.0.0.1", relay.tcp, role=0, resume=client)
        self.addCleanup(back.close)
        self.assertTrue(back.welcome.Resumed(), "no snapshot of a state before")
        self.assertEqual(back.replica.revision, revision)

    def test_a_session_that_is_not_there(self):
        nats = self.nats()
        relay = self.relay(nats).start(wait=False)
        wait_for("it says so", lambda: "session liver is not there" in relay.log())
        server = self.incised({"nats": nats.url, "name": "liver"})
        server.start()
        wait_for("then it serves it", relay.listens)
        self.assert_there(self.viewer(relay), server, relay)


if __name__ == "__main__":
    main()
