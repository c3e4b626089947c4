"""What incised publishes on NATS: read back by an independent reader, and with a NATS that fails in every way."""

import json
import signal
import subprocess
import time

from harness import BIN, ClusterTest, Nats, StreamReader, main, send_admin, stroke, wait_for
from incise.wire import Body


class PublishTest(ClusterTest):
    def start(self, nats, more=None, **cluster):
        server = self.incised({"nats": nats.url, "name": "liver", **cluster}, more=more)
        server.start()
        wait_for("it publishes", lambda: server.cluster()["connected"])
        return server

    def test_a_reader_rebuilds_the_state(self):
        nats = self.nats()
        server = self.start(nats)
        self.assert_published(nats, server)
        revision = stroke(server, 2)
        self.assertGreater(revision, 5)
        reader = self.assert_published(nats, server)
        self.assertEqual(reader.deltas, revision)
        self.assertEqual(reader.welcome.Mesh().Name(), b"slab")
        figures = server.cluster()
        self.assertEqual((figures["failures"], figures["dropped"], figures["connections"]), (0, 0, 1))

    def test_new_ids_are_published_as_a_new_epoch(self):
        nats = self.nats()
        server = self.incised({"nats": nats.url, "name": "liver"}, capture=self.folder / "session.capture")
        server.start()
        stroke(server)
        first = self.assert_published(nats, server).epoch
        stroke(server, offset=0.6)
        send_admin(server, Body.Body.Undo)
        link = Nats(nats.port)
        self.addCleanup(link.close)
        wait_for("the stroke is undone", lambda: StreamReader(link, "liver").read().epoch != first)
        second = self.assert_published(nats, server)
        self.assertGreater(second.revision, -1)
        send_admin(server, Body.Body.Reset)
        wait_for("it was reset", lambda: server.stats()["revision"] == 0)
        third = self.assert_published(nats, server).epoch
        self.assertEqual(len({first, second.epoch, third}), 3)
        stroke(server)
        self.assertEqual(self.assert_published(nats, server).epoch, third)
        # Killed and resumed, it is the same session.
        server.kill()
        server.start("--resume")
        self.assertEqual(self.assert_published(nats, server).epoch, third)

    def test_who_joins_has_little_to_read(self):
        nats = self.nats()
        server = self.start(nats, {"mesh": {"target_tets": 30000}}, join_megabytes=1, stream_megabytes=64)
        wait_for("there are more snapshots", lambda: stroke(server, 4) and server.cluster()["snapshots"] > 5)
        link = Nats(nats.port)
        self.addCleanup(link.close)

        def kept():
            return json.loads(link.request("$JS.API.STREAM.INFO.incise_liver"))["state"]

        wait_for("what nobody needs is purged", lambda: kept()["first_seq"] > 1)
        reader = self.assert_published(nats, server)
        self.assertGreater(reader.first, 1)
        self.assertLess(kept()["messages"], server.cluster()["messages"])
        self.assertEqual(reader.gaps, 0)

    def cut_meanwhile(self, server, harm, heal, back):
        """Strokes before, while and after NATS fails: the server goes on, and readers come to its state."""
        stroke(server)
        before = server.stats()
        harm()
        during = stroke(server, 2, offset=0.5)
        self.assertGreater(during, before["revision"])
        state = server.stats()
        self.assertFalse(state["limits"]["deltas_blocked"])
        self.assertEqual(state["poses"].get("queue_full", 0), 0)
        heal()
        wait_for("it publishes again: " + server.log(), back)
        stroke(server, offset=0.7)

    def test_nats_killed_and_back(self):
        nats = self.nats()
        server = self.start(nats)
        self.cut_meanwhile(server, nats.kill, nats.start, lambda: server.cluster()["connections"] > 1)
        self.assert_published(nats, server)
        self.assertIn("the session goes on, nothing is published", server.log())
        self.assertLess(server.log().count("the session goes on"), 6, "one line for one trouble")

    def test_nats_stands_still(self):
        nats = self.nats()
        server = self.start(nats)
        link = Nats(nats.port, timeout_s=30)
        self.addCleanup(link.close)
        self.assert_published(nats, server)
        reader = StreamReader(link, "liver").read()

        def heal():
            time.sleep(1)
            nats.go_on()

        self.cut_meanwhile(server, nats.pause, heal, lambda: server.cluster()["connected"])
        self.assert_published(nats, server)
        reader.read()
        self.assertEqual(reader.hash, int(server.stats()["state_hash"], 16))

    def test_nats_is_slow_and_little_may_wait(self):
        nats = self.nats()
        server = self.start(nats, {"mesh": {"target_tets": 30000}}, queue_megabytes=1, join_megabytes=1, stream_megabytes=64)

        def harm():
            nats.pause()
            lost = lambda c: c["dropped"] + c["failures"] > 0
            wait_for("too much waits", lambda: stroke(server, 4, offset=0.05) and lost(server.cluster()))

        self.cut_meanwhile(server, harm, nats.go_on, lambda: server.cluster()["connected"])
        self.assert_published(nats, server)

    def test_nats_is_full(self):
        # The account has less than a stream may take.
        nats = self.nats(max_mem="32M")
        server = self.incised({"nats": nats.url, "name": "liver", "stream_megabytes": 512})
        server.start()
        wait_for("it says so", lambda: "stream incise_liver: insufficient" in server.cluster()["trouble"])
        self.assertGreater(stroke(server), 0)

    def test_a_name_has_one_server(self):
        nats = self.nats()
        first = self.start(nats)
        wait_for("it is listed", lambda: "liver" in first.get("/sessions"))
        second = self.incised({"nats": nats.url, "name": "liver"}, name="second")
        second.start(wait=False)
        self.assertEqual(second.end(), 1)
        self.assertIn(f"session liver is published on {nats.url} by another incised (tcp://127.0.0.1:{first.tcp})", second.log())
        # One that was killed is none, though it is listed for a while.
        first.kill()
        second.start()
        self.assert_published(nats, second)

    def test_two_servers_that_could_not_see_each_other_say_so(self):
        nats = self.nats()
        nats.kill()
        both = [self.incised({"nats": nats.url, "name": "liver"}, name=name) for name in ("a", "b")]
        for one in both:
            one.start()
        nats.start()
        for one in both:
            wait_for("it says so: " + one.log(), lambda: "another server publishes session liver" in one.cluster()["trouble"])
            self.assertEqual(one.log().count("another server publishes session liver"), 1)
        both[0].stop()
        wait_for("it is over", lambda: both[1].cluster()["trouble"] == "")
        self.assert_published(nats, both[1])

    def test_the_stream_is_deleted_and_purged(self):
        nats = self.nats()
        server = self.start(nats)
        stroke(server)
        link = Nats(nats.port)
        self.addCleanup(link.close)
        for k in range(2):
            # The numbers of the next one begin again, below those of the snapshots that were in this one.
            link.request("$JS.API.STREAM.DELETE.incise_liver")
            stroke(server, offset=0.5 + 0.1 * k)
            wait_for("it is made again", lambda: server.cluster()["connections"] > 1 + k)
            self.assert_published(nats, server)
        # Nothing that is published fails after this.
        link.request("$JS.API.STREAM.PURGE.incise_liver")
        self.assert_published(nats, server)
        self.assertEqual(server.cluster()["connections"], 3)

    def test_jetstream_is_off(self):
        nats = self.nats()
        nats.kill()
        nats.config.write_text(f'listen: "127.0.0.1:{nats.port}"\n')
        nats.start()
        server = self.incised({"nats": nats.url, "name": "liver"})
        server.start()
        wait_for("it says so", lambda: "JetStream" in server.cluster()["trouble"])
        self.assertGreater(stroke(server), 0)

    def test_sessions_are_listed(self):
        nats = self.nats()
        server = self.start(nats, picture="https://example.org/liver.png")
        other = self.incised({"nats": nats.url, "name": "kidney"}, name="other")
        other.start()

        def listed():
            run = subprocess.run([BIN / "incise", "sessions", nats.url, "--json"], capture_output=True, text=True, timeout=30)
            self.assertEqual(run.returncode, 0, run.stderr)
            sessions = json.loads(run.stdout)
            return sessions if len(sessions) == 2 else None

        kidney, liver = wait_for("both are listed", listed)
        self.assertEqual((kidney["name"], liver["name"]), ("kidney", "liver"))
        self.assertEqual(liver["picture"], "https://example.org/liver.png")
        self.assertEqual(liver["places"][0]["tcp"], f"tcp://127.0.0.1:{server.tcp}")
        self.assertEqual(json.loads(other.get("/sessions"))[1]["body"], "slab")
        table = subprocess.run([BIN / "incise", "sessions", nats.url], capture_output=True, text=True, timeout=30).stdout
        self.assertIn("kidney", table)
        revision = stroke(server)
        watch = subprocess.run([BIN / "incise", "watch", nats.url + "/liver", "--until-revision", str(revision), "--json"],
                               capture_output=True, text=True, timeout=60)
        self.assertEqual(watch.returncode, 0, watch.stderr)
        self.assertEqual(json.loads(watch.stdout.strip().split("\n")[-1])["revision"], revision)
        missing = subprocess.run([BIN / "incise", "watch", nats.url + "/heart"], capture_output=True, text=True, timeout=60)
        self.assertEqual(missing.returncode, 1)
        self.assertIn('no session "heart"', missing.stderr)
        # One that ends takes its entry away, one that is killed is forgotten.
        other.stop()
        wait_for("it is gone", lambda: [s["name"] for s in json.loads(server.get("/sessions"))] == ["liver"])
        server.signal(signal.SIGKILL)
        server.end()

        def forgotten():
            run = subprocess.run([BIN / "incise", "sessions", nats.url, "--json"], capture_output=True, text=True, timeout=30)
            return json.loads(run.stdout) == []

        wait_for("it is forgotten", forgotten)


if __name__ == "__main__":
    main()
