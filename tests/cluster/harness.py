"""What the tests of several machines share: nats-server and incised as their users start them, a reader of NATS of a few lines that shares
no code with ours, and strokes."""

import base64
import json
import os
import signal
import socket
import ssl
import struct
import subprocess
import sys
import tempfile
import time
import unittest
import urllib.request
from pathlib import Path

import incise_client
from incise.wire import Body, Delta, Message, SnapshotBegin, SnapshotChunk, SnapshotEnd, SurfaceDelta, Welcome
from incise_client.replica import Replica

BIN = Path(os.environ["INCISE_BIN_DIR"])
LONG_S = 60.0  # for what takes a moment


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def wait_for(what, condition, seconds=LONG_S, told=()):
    """The first true value of condition(); `told`: what is shown, as it is then, if there is none."""
    end = time.monotonic() + seconds
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > end:
            raise AssertionError(f"not within {seconds} s: {what} {told}")
        time.sleep(0.05)


class NatsServer:
    """nats-server on a port of its own, with JetStream in a folder."""

    def __init__(self, folder, more="", max_mem="1G", address="127.0.0.1"):
        self.port = free_port()
        self.folder = Path(folder)
        self.config = self.folder / f"nats-{self.port}.conf"
        self.config.write_text(f'listen: "{address}:{self.port}"\n'
                               f'jetstream {{ store_dir: "{self.folder}/js", max_mem: {max_mem}, max_file: 1G }}\n{more}\n')
        self.process = None
        self.start()

    @property
    def url(self):
        return f"nats://127.0.0.1:{self.port}"

    def start(self):
        self.log = open(self.folder / "nats.log", "a")
        self.process = subprocess.Popen(["nats-server", "-c", str(self.config)], stdout=self.log, stderr=self.log)

        def open_port():
            assert self.process.poll() is None, (self.folder / "nats.log").read_text()
            with socket.socket() as s:
                return s.connect_ex(("127.0.0.1", self.port)) == 0

        wait_for("nats-server listens", open_port)

    def kill(self):
        self.process.kill()
        self.process.wait()
        self.log.close()

    def pause(self):
        self.process.send_signal(signal.SIGSTOP)

    def go_on(self):
        self.process.send_signal(signal.SIGCONT)


class Nats:
    """NATS's text protocol over a socket."""

    def __init__(self, port, user=None, password=None, ca=None, timeout_s=5.0):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout_s)
        self.socket.settimeout(timeout_s)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # else each of two small messages in a row waits 40 ms
        self.buffer = b""
        line = self._line()
        assert line.startswith(b"INFO "), line
        if ca:
            context = ssl.create_default_context(cafile=ca)
            self.socket = context.wrap_socket(self.socket, server_hostname="127.0.0.1")
        connect = {"verbose": False, "pedantic": False, "headers": True, "lang": "test", "version": "0"}
        if user:
            connect.update({"user": user, "pass": password})
        self._send(b"CONNECT " + json.dumps(connect).encode() + b"\r\nPING\r\n")
        self.sids = 0
        while True:
            line = self._line()
            if line == b"PONG":
                return
            if line.startswith(b"-ERR"):
                self.close()
                raise ConnectionError(line.decode())

    def close(self):
        self.socket.close()

    def _send(self, data):
        self.socket.sendall(data)

    def _fill(self):
        data = self.socket.recv(1 << 20)
        if not data:
            self.close()
            raise ConnectionError("closed")
        self.buffer += data

    def _line(self):
        while b"\r\n" not in self.buffer:
            self._fill()
        line, self.buffer = self.buffer.split(b"\r\n", 1)
        return line

    def _bytes(self, n):
        while len(self.buffer) < n + 2:
            self._fill()
        data, self.buffer = self.buffer[:n], self.buffer[n + 2:]
        return data

    def subscribe(self, subject):
        self.sids += 1
        self._send(f"SUB {subject} {self.sids}\r\n".encode())
        return self.sids

    def publish(self, subject, data=b"", reply=""):
        self._send(f"PUB {subject} {reply} {len(data)}\r\n".encode() + data + b"\r\n")

    def message(self):
        """The next message: subject, header block, data."""
        while True:
            words = self._line().split()
            if words[0] == b"PING":
                self._send(b"PONG\r\n")
            elif words[0] == b"-ERR":
                raise PermissionError(b" ".join(words[1:]).decode())
            elif words[0] == b"MSG":
                return words[1].decode(), b"", self._bytes(int(words[-1]))
            elif words[0] == b"HMSG":
                header, total = int(words[-2]), int(words[-1])
                data = self._bytes(total)
                return words[1].decode(), data[:header], data[header:]

    def request(self, subject, data=b""):
        inbox = f"_INBOX.{os.urandom(8).hex()}"
        self.subscribe(inbox)
        self.publish(subject, data, inbox)
        return self.message()[2]

    def stream_message(self, stream, **which):
        """A message that JetStream keeps, None if there is none: subject, headers, data, its number."""
        answer = json.loads(self.request(f"$JS.API.STREAM.MSG.GET.{stream}", json.dumps(which).encode()))
        if "error" in answer:
            if answer["error"]["code"] == 404:
                return None
            raise PermissionError(answer["error"]["description"])
        m = answer["message"]
        return m["subject"], parse_headers(base64.b64decode(m.get("hdrs", ""))), base64.b64decode(m.get("data", "")), m["seq"]


def parse_headers(block):
    lines = block.decode().split("\r\n")[1:]
    return dict(line.split(": ", 1) if ": " in line else line.split(":", 1) for line in lines if line)


class StreamReader:
    """Rebuilds a session from what JetStream keeps, as NATS.md says, from the newest Welcome on; checks every header."""

    def __init__(self, nats, session, view="volume"):
        self.nats, self.stream, self.root = nats, f"incise_{session}", f"incise.{session}.{view}"
        first = nats.stream_message(self.stream, last_by_subj=self.root + ".welcome")
        self.next = first[3] if first else None
        self.first = self.next
        self.parts = []
        self.welcome = self.replica = None
        self.epoch = None
        self.revision = self.hash = None
        self.deltas = self.bytes = 0
        self.gaps = 0

    def read(self):
        """Reads to the end of what there is."""
        while self.next is not None:
            got = self.nats.stream_message(self.stream, seq=self.next, next_by_subj=self.root + ".>")
            if not got:
                return self
            self.next = got[3] + 1
            self._part(*got)
        return self

    def _part(self, subject, headers, data, _):
        self.bytes += len(data)
        assert len(data) + 4096 < 1 << 20
        part, parts = map(int, headers.get("Incise-Part", "1/1").split("/"))
        self.parts = self.parts[:part - 1] + [data]
        assert len(self.parts) == part, "a part is missing"
        if part == parts:
            self._message(subject.rsplit(".", 1)[1], headers, b"".join(self.parts))

    def _message(self, kind, headers, data):
        m = Message.Message.GetRootAs(data, 0)

        def body(table):
            out = table()
            out.Init(m.Body().Bytes, m.Body().Pos)
            return out

        if kind == "welcome":
            assert m.BodyType() == Body.Body.Welcome
            self.welcome = body(Welcome.Welcome)
            self.epoch = headers["Incise-Epoch"]
            self.chunks = []
            self.begin = None
        elif kind == "snapshot":
            assert headers["Incise-Epoch"] == self.epoch
            if m.BodyType() == Body.Body.SnapshotBegin:
                self.begin = body(SnapshotBegin.SnapshotBegin)
            elif m.BodyType() == Body.Body.SnapshotChunk:
                self.chunks.append(body(SnapshotChunk.SnapshotChunk))
            elif m.BodyType() == Body.Body.SnapshotEnd and self.begin:
                end = body(SnapshotEnd.SnapshotEnd)
                self.revision, self.hash = self.begin.Revision(), end.StateHash()
                assert int(headers["Incise-Revision"]) == self.revision
                if self.root.endswith("volume"):
                    self.replica = Replica.from_snapshot(self.begin, self.chunks, end)
        elif self.revision is not None and headers["Incise-Epoch"] == self.epoch:
            delta = body(Delta.Delta if m.BodyType() == Body.Body.Delta else SurfaceDelta.SurfaceDelta)
            assert int(headers["Incise-Revision"]) == delta.Revision()
            if delta.Revision() <= self.revision:
                return
            if delta.BaseRevision() != self.revision or int(headers["Incise-Base-Hash"], 16) != self.hash:
                self.gaps += 1
                self.revision = None
                return
            if self.replica is not None:
                self.replica.apply(delta)
            self.revision, self.hash = delta.Revision(), delta.StateHash()
            self.deltas += 1


class Incised:
    """incised on a phantom slab, with its files in a folder."""

    def __init__(self, folder, cluster, name="incised", capture=None, more=None):
        self.folder, self.name = Path(folder), name
        self.config = self.folder / f"{name}.json"
        config = {
            "mesh": {"phantom": "slab", "target_tets": 3000, "cache_directory": str(self.folder)},
            "loop": {"realtime_priority": 0, "lock_memory": False},
            "listen": {"tcp_port": 0, "http_port": 0, "stop_grace_s": 0.2},
            "devices": {"enabled": False},
            "capture": {"path": str(capture) if capture else ""},
            "cluster": cluster,
        }
        for section, keys in (more or {}).items():
            config.setdefault(section, {}).update(keys)
        self.config.write_text(json.dumps(config))
        self.process = None

    def start(self, *arguments, wait=True):
        self.log_file = open(self.folder / f"{self.name}.log", "a")
        self.process = subprocess.Popen([str(BIN / "incised"), "--config", str(self.config), *arguments],
                                        stdout=subprocess.PIPE, stderr=self.log_file)
        os.set_blocking(self.process.stdout.fileno(), False)
        self.pending = ""
        if wait:
            wait_for("incised listens: " + self.log(), self.listens)
        return self

    def listens(self):
        """Whether it does; then its ports are known."""
        self.pending += (self.process.stdout.read() or b"").decode()
        if "listening " not in self.pending or "\n" not in self.pending:
            assert self.process.poll() is None, self.log()
            return False
        words = dict(w.split("=", 1) for w in self.pending.split("\n")[0].split()[1:])
        self.tcp, self.http = (int(words[k].rsplit(":", 1)[1]) for k in ("tcp", "http"))
        return True

    def log(self):
        return (self.folder / f"{self.name}.log").read_text()

    def get(self, path):
        with urllib.request.urlopen(f"http://127.0.0.1:{self.http}{path}", timeout=10) as answer:
            return answer.read().decode()

    def stats(self):
        return json.loads(self.get("/stats"))

    def cluster(self):
        return self.stats()["cluster"]

    def signal(self, number):
        self.process.send_signal(number)

    def kill(self):
        if self.process and self.process.poll() is None:
            self.process.kill()
        self.end()

    def end(self, seconds=LONG_S):
        """Waits for its end; the exit code."""
        if not self.process:
            return None
        code = self.process.wait(seconds)
        self.log_file.close()
        self.process.stdout.close()
        return code

    def stop(self):
        self.signal(signal.SIGTERM)
        return self.end()


def stroke(server, passes=1, offset=0.3, token=""):
    """Cuts across the slab and waits until everything is cut; the revision then."""
    with incise_client.connect("127.0.0.1", server.tcp, role=1, token=token) as client:
        assert client.wait_for_revision(0)
        t, sequence = time.monotonic_ns(), 0
        for k in range(passes):
            x = 0.1 * ((offset + 0.13 * k) % 0.8 + 0.1)
            poses = []
            for i in range(160):
                t += 4_000_000
                poses.append(incise_client.Pose(t, (x, -0.01 + 0.0005 * i, 0.03), buttons=1 if 2 < i < 157 else 0))
            sequence = client.send_poses(poses)
        assert client.wait_for_report(sequence, LONG_S)
        wait_for("everything is cut", lambda: client.poll(0.05) >= 0 and client.report.BacklogSegments() == 0)
    wait_for("nothing is cut any more", lambda: server.stats()["backlog"]["segments"] == 0)
    return server.stats()["revision"]


def send_admin(server, body, token="", unless=None):
    """Sends a message without fields, as an admin. Whether the server has nothing against it, but for what has this text."""
    import flatbuffers
    with incise_client.connect("127.0.0.1", server.tcp, role=3, view=0, token=token) as client:
        b = flatbuffers.Builder(64)
        b.StartObject(0)
        empty = b.EndObject()
        Message.Start(b)
        Message.AddSequence(b, 2)
        Message.AddBodyType(b, body)
        Message.AddBody(b, empty)
        b.Finish(Message.End(b), b"INC1")
        data = bytes(b.Output())
        client._socket.sendall(struct.pack("<I", len(data)) + data)
        time.sleep(0.2)
        client.poll(0.1)
        error = client.error and client.error.Text().decode()
        refused = unless is not None and error is not None and unless in error
        assert error is None or refused, error
        return not refused


class ClusterTest(unittest.TestCase):
    """A folder and what is started in it, all of which goes with the test."""

    def setUp(self):
        self.temporary = tempfile.TemporaryDirectory(prefix="incise-cluster-", ignore_cleanup_errors=True)
        self.folder = Path(self.temporary.name)
        self.started = []
        self.addCleanup(self._end)

    def _end(self):
        for one in reversed(self.started):
            if not one.process:
                continue
            try:
                one.process.send_signal(signal.SIGCONT)
                one.kill()
            except (ProcessLookupError, ValueError, OSError):
                pass
        self.temporary.cleanup()

    def nats(self, **options):
        self.started.append(NatsServer(self.folder, **options))
        return self.started[-1]

    def incised(self, cluster, **options):
        self.started.append(Incised(self.folder, cluster, **options))
        return self.started[-1]

    def assert_published(self, nats, server, session="liver", user=None):
        """What NATS keeps leads a reader that begins now to the server's state, in both views."""

        seen = []

        def leads_there():
            link = Nats(nats.port)
            try:
                state = server.stats()
                volume = StreamReader(link, session).read()
                surface = StreamReader(link, session, "surface").read()
            finally:
                link.close()
            want = (state["revision"], int(state["state_hash"], 16))
            seen[:] = [want, *((one.revision, one.hash, one.first, one.next, one.gaps, one.deltas) for one in (volume, surface))]
            if (volume.revision, volume.hash) != want or (surface.revision, surface.hash) != want:
                return None
            self.assertEqual(volume.replica.compute_state_hash(), want[1])
            return volume

        return wait_for("a reader comes to the server's state: " + server.log(), leads_there, told=seen)


def main():
    unittest.main(argv=[sys.argv[0], "-v", *sys.argv[1:]])
