"""A relay on TCP, a relay on NATS, nats-server and the links between them are killed, stopped and cut while somebody cuts: viewers come to
the server's state, never go back, and the server's frames take as long as without.

INCISE_CHAOS_ROUNDS (8) and INCISE_CHAOS_SEED (the clock) change what is done. Links are cut in a network namespace of the test's own, which `unshare`
makes without rights where the system lets users do so; elsewhere they are left alone, and the report says so."""

import collections
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
import urllib.request

import incise_client
from harness import ClusterTest, main, send_admin, wait_for
from incise.wire import Body, View
from relay_test import Relay

ROUNDS = int(os.environ.get("INCISE_CHAOS_ROUNDS", "8"))
SEED = int(os.environ.get("INCISE_CHAOS_SEED", str(time.time_ns() % 1_000_000)))
INSIDE = "INCISE_CHAOS_NAMESPACE"
CHECK_EVERY = 5  # rounds, after which all viewers must come to the server's state
UNDO_EVERY = 3   # rounds: a stroke is undone, which begins an epoch in the midst of everything
RESET_EVERY = 8  # rounds, so that the body stays small


class Link:
    """An address of this machine, whose packets in both directions are dropped while it is cut."""

    def __init__(self, number):
        self.server, self.client = f"127.0.{number}.1", f"127.0.{number}.2"
        self.route("add", "local", self.client)
        self.route("add", "local", self.server)

    def route(self, verb, kind, address):
        more = ["dev", "lo", "src", "127.0.0.1" if address == self.client else self.client] if kind == "local" else []
        subprocess.run(["ip", "route", verb, kind, address + "/32", *more, "table", "local"], check=True)

    def cut(self):
        for address in (self.server, self.client):
            self.route("replace", "blackhole", address)

    def mend(self):
        for address in (self.client, self.server):
            self.route("del", "blackhole", address)
            self.route("add", "local", address)


class Viewer(threading.Thread):
    """A viewer that stays, and comes back with what it has after each lost connection."""

    def __init__(self, name, port, view):
        super().__init__(daemon=True)
        self.viewer_name, self.port, self.view = name, port, view
        self.client = None
        self.last = (0, 0)  # epoch and revision
        self.wrong = ""
        self.connections = self.resumed = self.snapshots = self.resyncs = 0
        self.before = None         # the client that was lost, with its state
        self.state = (None, None)  # epoch and revision; the hash, computed where the view has all that it is of
        self.ending = threading.Event()
        self.start()

    def run(self):
        while not self.ending.is_set():
            try:
                if self.client is None:
                    self.connect()
                self.follow()
            except (incise_client.ConnectError, OSError):
                self.leave()
                time.sleep(0.1)
            except Exception as error:  # of this thread, which would die without a word
                self.wrong = repr(error)
                return
        if self.client:
            self.client.close()

    def connect(self):
        self.client = incise_client.connect("127.0.0.1", self.port, role=0, view=self.view, resume=self.before)
        self.connections += 1
        self.resumed += bool(self.client.welcome.Resumed())

    def leave(self):
        if self.client is None:
            return
        self.client._socket.close()
        self.resyncs += self.client.resyncs
        self.snapshots += self.client.snapshots
        if self.client.snapshots_or_resumed:
            self.before = self.client
        self.client = None

    def follow(self):
        came = self.client.poll(0.05)
        if not self.client.snapshots_or_resumed or self.client._awaiting_snapshot:
            return
        now = (self.client.welcome.Session(), self.client.replica.revision)
        if now[0] == self.last[0] and now[1] < self.last[1]:
            self.wrong = f"went back from revision {self.last[1]} to {now[1]}"
        self.last = now
        if came == 0:  # a pause; the hash is costly
            if self.state[0] != now:
                whole = self.view == View.View.Volume
                self.state = (now, self.client.replica.compute_state_hash() if whole else self.client._state_hash)

    def end(self):
        self.ending.set()
        self.join(10)
        self.leave()


class Operator(threading.Thread):
    """Cuts all the time at the server, at 250 Hz, each pass somewhere else; pause() ends with all of it cut."""

    def __init__(self, server, random_):
        super().__init__(daemon=True)
        self.server, self.random = server, random_
        self.go, self.ending = threading.Event(), threading.Event()
        self.idle = threading.Event()
        self.go.set()
        self.wrong = ""
        self.passes = 0
        self.start()

    def run(self):
        try:
            with incise_client.connect("127.0.0.1", self.server.tcp, role=1, view=0) as client:
                while not self.ending.is_set():
                    if not self.go.is_set():
                        client.poll(0.02)
                        self.idle.set()
                        continue
                    self.idle.clear()
                    self.cut(client)
        except Exception as error:
            self.wrong = repr(error)

    def cut(self, client):
        x = 0.01 + 0.08 * self.random.random()
        due = time.monotonic()
        for i in range(160):
            pose = incise_client.Pose(time.monotonic_ns(), (x, -0.01 + 0.0005 * i, 0.03), buttons=1 if 2 < i < 157 else 0)
            client.send_poses([pose])
            due += 0.004
            client.poll(max(0.0, due - time.monotonic()))
            time.sleep(max(0.0, due - time.monotonic()))
        self.passes += 1

    def pause(self):
        self.go.clear()
        wait_for("the operator pauses " + self.wrong, lambda: self.idle.is_set() or self.wrong)
        wait_for("everything is cut", lambda: self.server.stats()["backlog"]["segments"] == 0)

    def end(self):
        self.ending.set()
        self.join(10)


class ChaosTest(ClusterTest):
    def setUp(self):
        super().setUp()
        self.random = random.Random(SEED)
        self.links = {}
        if os.environ.get(INSIDE):
            subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
            self.links = {name: Link(number) for number, name in enumerate(("relay-server", "relay-nats", "server-nats"), 2)}

    def address(self, link):
        return self.links[link].server if link in self.links else "127.0.0.1"

    def set_up(self):
        self.nats_server = self.nats(address="0.0.0.0")
        port = self.nats_server.port
        cluster = {"nats": f"nats://{self.address('server-nats')}:{port}", "name": "liver", "advertise": self.address("relay-server")}
        self.server = self.incised(cluster,
                                   name=f"incised-{len(self.started)}", capture=self.folder / "session.capture",
                                   more={"listen": {"address": "0.0.0.0", "insecure": True}})
        self.server.start()
        sources = {"tcp": ["--to", f"{self.address('relay-server')}:{self.server.tcp}", "--upstream-http-port", self.server.http],
                   "nats": ["--nats", f"nats://{self.address('relay-nats')}:{port}", "--session", "liver"]}
        self.relays = {name: Relay(self.folder, source, f"relay-{name}-{len(self.started)}").start() for name, source in sources.items()}
        self.started += self.relays.values()
        ports = {"server": self.server.tcp, **{name: relay.tcp for name, relay in self.relays.items()}}
        views = {"volume": View.View.Volume, "surface": View.View.Surface}
        self.viewers = [Viewer(f"{place} {view}", ports[place], views[view]) for place in ports for view in views]
        self.operator = Operator(self.server, self.random)

    def take_down(self):
        self.operator.end()
        for one in self.viewers:
            one.end()
        for relay in self.relays.values():
            relay.kill()
        self.server.stop()
        self.nats_server.kill()

    def no_trouble(self):
        for one in (self.operator, *self.viewers):
            self.assertEqual(one.wrong, "", f"{getattr(one, 'viewer_name', 'operator')}, seed {SEED}")

    def assert_all_there(self):
        """All viewers come to the server's state, once nobody cuts."""
        self.operator.pause()

        def behind():
            self.no_trouble()
            state = self.server.stats()  # each time: a stroke may still be about to be undone
            want = (state["revision"], int(state["state_hash"], 16))
            return [f"{v.viewer_name} is at {v.state}, the server at {want}" for v in self.viewers
                    if v.client is None or v.state[0] is None or (v.state[0][1], v.state[1]) != want]

        began = time.monotonic()
        try:
            wait_for("all viewers are at the server's state", lambda: not behind())
        except AssertionError as error:
            logs = "\n".join(f"{name}: {relay.log()[-3000:]}" for name, relay in self.relays.items())
            raise AssertionError(f"seed {SEED}: {error}: {behind()}\n{logs}\n{self.server.log()[-2000:]}") from None
        self.operator.go.set()
        return time.monotonic() - began

    # ---- What is done to them: what ends it ----

    def kill_relay(self, name):
        self.note_relay(name)
        self.relays[name].kill()
        return lambda: self.relays[name].start(wait=False)

    def stop_relay(self, name):
        self.relays[name].signal(signal.SIGSTOP)
        return lambda: self.relays[name].signal(signal.SIGCONT)

    def kill_nats(self):
        self.nats_server.kill()
        return self.nats_server.start

    def stop_nats(self):
        self.nats_server.pause()
        return self.nats_server.go_on

    def cut_link(self, name):
        self.links[name].cut()
        return self.links[name].mend

    def harms(self):
        out = {"kill nats": (self.kill_nats,), "stop nats": (self.stop_nats,)}
        for name in self.relays:
            out[f"kill relay {name}"] = (self.kill_relay, name)
            out[f"stop relay {name}"] = (self.stop_relay, name)
        for name in self.links:
            out[f"cut {name}"] = (self.cut_link, name)
        return out

    def note_relay(self, name):
        """Adds what a relay has counted, as far as it can be asked."""
        relay = self.relays[name]
        try:
            relay.listens()
            with urllib.request.urlopen(f"http://127.0.0.1:{relay.http}/stats", timeout=1) as answer:
                figures = json.loads(answer.read())["relay"]
        except (OSError, AssertionError, AttributeError, KeyError):
            return
        for key in ("connections", "resumed", "snapshots", "refused", "epochs"):
            self.counted[key] += figures[key]

    def frames(self):
        figures = self.server.stats()
        work = figures["stages_us"]["frame_work"]
        out = {key: round(work[key]) for key in ("p50", "p90", "p99", "p99.9", "max")}
        return {"work_us": out, "wake_late_p99.9_us": round(figures["stages_us"]["wake_late"]["p99.9"]), "frames": work["count"],
                "late": figures["frames"]["late"], "skipped": figures["frames"]["skipped"]}

    def play(self, rounds, harms):
        """Strokes, undone strokes and resets, while these are done; how long it took viewers at most to come to the server's state."""
        slowest = 0.0
        for number in range(1, rounds + 1):
            # Sometimes two at a time; what is harmed already is left alone.
            chosen = self.random.sample(sorted(harms), self.random.choice((1, 1, 2))) if harms else []
            chosen = [one for i, one in enumerate(chosen) if one.split()[1:] not in [other.split()[1:] for other in chosen[:i]]]
            heal = [harms[name][0](*harms[name][1:]) for name in chosen]
            self.done.update(chosen)
            # Mostly short, sometimes longer than it takes to notice silence.
            time.sleep(self.random.choice((0.05, 0.3, 1.0, 1.0, 2.0, 6.0)))
            for end in heal:
                end()
            self.no_trouble()
            if number % UNDO_EVERY == 0:
                # The operator's next stroke may begin before it is done.
                self.assertTrue(any(send_admin(self.server, Body.Body.Undo, unless="a stroke has begun since") for _ in range(20)))
            if number % RESET_EVERY == 0:
                send_admin(self.server, Body.Body.Reset)
            time.sleep(0.5 * self.random.random())
            if number % CHECK_EVERY == 0 or number == rounds:
                slowest = max(slowest, self.assert_all_there())
        return slowest

    def test_viewers_come_to_the_servers_state_and_never_go_back(self):
        self.counted, self.done = collections.Counter(), collections.Counter()
        self.set_up()
        self.play(ROUNDS // 3, {})
        without = self.frames()
        self.take_down()

        self.set_up()
        began = time.monotonic()
        slowest = self.play(ROUNDS, self.harms())
        seconds = time.monotonic() - began
        with_chaos, cluster = self.frames(), self.server.cluster()
        for name in self.relays:
            self.note_relay(name)
        for relay in self.relays.values():
            self.assertNotIn("does not fit", relay.log(), f"seed {SEED}: what a relay gets leads from what it has to the hash that is announced")
        self.take_down()
        self.no_trouble()
        viewers = {v.viewer_name: f"{v.connections} connections, {v.resumed} resumed, {v.snapshots} snapshots, {v.resyncs} resyncs"
                   for v in self.viewers}
        report = {"seed": SEED, "rounds": ROUNDS, "seconds": round(seconds), "passes": self.operator.passes, "links": bool(self.links),
                  "slowest_to_the_servers_state_s": round(slowest, 1), "done": self.done, "viewers": viewers, "relays": self.counted,
                  "publisher": cluster, "frames_without": without, "frames_with": with_chaos}
        print("\n" + "\n".join(f"  {key}: {json.dumps(value)}" for key, value in report.items()))
        self.assertEqual(sum(v.resyncs for v in self.viewers), 0)
        self.assertEqual(sum(v.connections for v in self.viewers if v.port == self.server.tcp), 2, "the server's own viewers notice nothing")
        self.assertGreaterEqual(sum(self.done.values()), ROUNDS)


if __name__ == "__main__":
    alone = ["unshare", "--map-root-user", "--net"]
    if INSIDE not in os.environ and shutil.which("ip") and subprocess.run([*alone, "true"], capture_output=True).returncode == 0:
        os.execvpe(alone[0], [*alone, sys.executable, "-B", *sys.argv], {**os.environ, INSIDE: "1"})
    main()
