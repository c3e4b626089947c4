"""Two instances of a session, one capture: at most one writes, whatever is killed, stopped, wiped or started at once."""

import json
import signal
import socket
import subprocess
import threading
import time
import unittest
import urllib.error
import urllib.request

import incise_client
from harness import BIN, ClusterTest, Nats, main, stroke, wait_for

LEASE_S = 3.0


class FailoverTest(ClusterTest):
    def setUp(self):
        super().setUp()
        self.capture = self.folder / "session.capture"

    def instance(self, nats, name, **cluster):
        return self.incised({"nats": nats.url, "name": "liver", "failover": True, "lease_s": LEASE_S, **cluster}, name=name,
                            capture=self.capture)

    def pair(self, nats):
        """The one that has the session, and the one that stands by."""
        a, b = self.instance(nats, "a").start(), self.instance(nats, "b")
        b.start(wait=False)
        wait_for("the other stands by", lambda: "standing by" in b.log())
        return a, b

    def whole(self):
        """The capture replays to its own hashes: nobody wrote into it but its holders."""
        run = subprocess.run([BIN / "incise", "replay", self.capture, "--verify"], capture_output=True, text=True, timeout=120)
        self.assertEqual(run.returncode, 0, run.stdout + run.stderr)
        return run.stdout

    def state(self, server):
        figures = server.stats()
        return figures["revision"], figures["state_hash"]

    def test_killed(self):
        nats = self.nats()
        a, b = self.pair(nats)
        stroke(a)
        before, epoch = self.state(a), self.assert_published(nats, a).epoch
        a.kill()
        wait_for("the other has it: " + b.log(), b.listens)
        self.assertEqual(self.state(b), before)
        self.assertEqual(self.assert_published(nats, b).epoch, epoch)
        self.assertIn("taking it over", b.log())
        stroke(b, offset=0.6)
        self.assert_published(nats, b)
        # The first one comes back, and stands by in turn.
        a.start(wait=False)
        wait_for("it stands by", lambda: a.log().count("standing by") == 1)
        self.assertEqual(b.stop(), 0)
        wait_for("it has it again", a.listens)
        self.assertNotIn("taking it over", a.log(), "the other has given it up")
        self.assert_published(nats, a)
        self.whole()

    def test_one_that_stands_by_answers_its_probe(self):
        nats = self.nats()
        a = self.instance(nats, "a").start()
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        b = self.incised({"nats": nats.url, "name": "liver", "failover": True, "lease_s": LEASE_S}, name="b", capture=self.capture,
                        more={"listen": {"http_port": port}})
        b.start(wait=False)
        b.http = port

        def get(path):
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=10) as answer:
                    return answer.status, answer.read().decode()
            except urllib.error.HTTPError as error:
                return error.code, error.read().decode()

        def health():
            try:
                return get("/healthz")
            except OSError:
                return None

        status, text = wait_for("it answers", health)
        self.assertEqual(status, 200)
        self.assertIn("standing by", json.loads(text)["status"])
        for path in ("/stats", "/", "/ws"):
            self.assertEqual(get(path)[0], 503, path)
        a.kill()
        wait_for("the other has it: " + b.log(), b.listens)
        self.assertEqual(b.http, port)
        self.assertEqual(json.loads(get("/healthz")[1])["status"], "ok")
        self.assertEqual(b.stop(), 0)

    def test_stopped_and_continued(self):
        nats = self.nats()
        a, b = self.pair(nats)
        stroke(a)
        # Poses wait in its sockets and queues when it stops, and it would cut them when it goes on.
        cutting = threading.Thread(target=self.cut_until_lost, args=(a,))
        cutting.start()
        wait_for("it cuts", lambda: a.stats()["revision"] > 10)
        a.signal(signal.SIGSTOP)
        wait_for("the other has it", b.listens)
        revision = stroke(b, offset=0.6)
        size = self.settled_size()
        a.signal(signal.SIGCONT)
        self.assertEqual(a.end(), 1)
        cutting.join()
        self.assertIn("the lease of session liver is lost", a.log())
        self.assertEqual(self.capture.stat().st_size, size, "nothing was written")
        self.assertEqual(self.state(b)[0], revision)
        self.assert_published(nats, b)
        stroke(b, offset=0.1)
        self.assert_published(nats, b)
        self.assertEqual(b.stop(), 0)
        self.whole()

    def settled_size(self):
        """The capture's, once its holder has written what it had to."""
        size = -1
        while size != self.capture.stat().st_size:
            size = self.capture.stat().st_size
            time.sleep(2)
        return size

    @staticmethod
    def cut_until_lost(server):
        try:
            stroke(server, 40)
        except (OSError, AssertionError, incise_client.ConnectError):
            pass  # it has gone

    def test_a_short_stop_is_survived(self):
        nats = self.nats()
        a, b = self.pair(nats)
        a.signal(signal.SIGSTOP)
        time.sleep(LEASE_S / 3)
        a.signal(signal.SIGCONT)
        time.sleep(LEASE_S * 1.5)
        stroke(a)
        self.assertFalse(b.listens())
        self.assert_published(nats, a)

    def test_nats_killed_and_back(self):
        nats = self.nats()
        a, b = self.pair(nats)
        stroke(a)
        nats.kill()
        time.sleep(LEASE_S / 6)
        nats.start()
        # The key was on its disk.
        wait_for("it publishes again", lambda: a.cluster()["connections"] > 1)
        time.sleep(LEASE_S * 1.5)
        stroke(a, offset=0.6)
        self.assertFalse(b.listens(), "the session stays where it is")
        self.assert_published(nats, a)

    def test_nats_stays_away(self):
        nats = self.nats()
        a, b = self.pair(nats)
        stroke(a)
        before = self.state(a)
        nats.kill()
        self.assertEqual(a.end(), 1)
        self.assertIn("is lost", a.log())
        self.assertFalse(b.listens())
        nats.start()
        wait_for("the other has it", b.listens)
        self.assertEqual(self.state(b), before)
        self.whole()

    def test_both_at_once(self):
        nats = self.nats()
        both = [self.instance(nats, name) for name in "ab"]
        for one in both:
            one.start(wait=False)
        first = wait_for("one has it", lambda: next((one for one in both if one.listens()), None))
        other = both[1 - both.index(first)]
        time.sleep(LEASE_S * 1.5)
        self.assertFalse(other.listens())
        self.assertIn("standing by", other.log())
        stroke(first)
        self.assertEqual(first.stop(), 0)
        wait_for("then the other", other.listens)
        self.assert_published(nats, other)

    def test_the_leases_are_wiped(self):
        nats = self.nats()
        a, b = self.pair(nats)
        stroke(a)
        link = Nats(nats.port)
        self.addCleanup(link.close)
        for _ in range(2):
            link.request("$JS.API.STREAM.DELETE.KV_incise_leases")
            # Whoever makes the key again: never both.
            end = time.monotonic() + 2.5 * LEASE_S
            while time.monotonic() < end:
                alive = [one for one in (a, b) if one.process.poll() is None and one.listens()]
                self.assertLessEqual(len([one for one in alive if self.writes(one)]), 1)
                time.sleep(0.2)
            holder = wait_for("one has it", lambda: next((x for x in (a, b) if x.process.poll() is None and x.listens()), None))
            stroke(holder, offset=0.5)
            self.assert_published(nats, holder)
            loser = b if holder is a else a
            if loser.process.poll() is not None:
                self.assertIn("is lost", loser.log())
                loser.end()
                loser.start(wait=False)
        self.assertEqual(holder.stop(), 0)
        self.whole()

    @staticmethod
    def writes(server):
        try:
            return server.cluster()["connected"]
        except OSError:
            return False

    def test_a_signal_ends_the_wait(self):
        nats = self.nats()
        a, b = self.pair(nats)
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            b.signal(number)
            self.assertEqual(b.end(), 0, b.log())
            self.assertIn(f"{number.name}: ending; another instance had the session", b.log())
            stood_by = b.log().count("standing by")
            b.start(wait=False)
            wait_for("it stands by again", lambda: b.log().count("standing by") > stood_by)
        self.assertTrue(a.listens())

    def test_wrong_configurations(self):
        nats = self.nats()
        for cluster, key in (({"nats": "http://here"}, "cluster.nats: found"), ({"nats": nats.url, "name": "a b"}, "cluster.name: found"),
                             ({"nats": "nats://example.org:4222", "name": "liver"}, "tls://host:port beyond loopback"),
                             ({"nats": nats.url, "name": "liver", "failover": True}, "cluster.failover: found"),
                             ({"failover": True}, "cluster.failover: found"),
                             ({"nats": nats.url, "name": "liver", "credentials_file": "none.json"}, "cluster.credentials_file: found"),
                             ({"nats": nats.url, "name": "liver", "join_megabytes": 300}, "cluster.stream_megabytes: found")):
            server = self.incised(cluster, name="wrong")
            run = subprocess.run([BIN / "incised", "--check", server.config], capture_output=True, text=True, timeout=30)
            self.assertEqual(run.returncode, 1, cluster)
            self.assertIn(key, run.stderr)


if __name__ == "__main__":
    main()
