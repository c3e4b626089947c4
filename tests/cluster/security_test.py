"""NATS with TLS and users that may see one session each: what is refused, and what it says."""

import json
import ssl
import subprocess
from pathlib import Path

from harness import BIN, ClusterTest, Nats, StreamReader, main, stroke, wait_for
from relay_test import Relay, Viewer

# Less than in NATS.md: a server may write its session, a reader of one session may read that.
USERS = """
authorization {
  users: [
    { user: "liver", password: "writes", permissions: {
        publish: ["incise.liver.>", "$JS.API.>", "$KV.incise_sessions.liver.>"], subscribe: ["_INBOX.>"] } },
    { user: "audience", password: "reads", permissions: {
        publish: ["$JS.API.INFO", "$JS.API.STREAM.INFO.incise_liver", "$JS.API.STREAM.MSG.GET.incise_liver",
                  "$JS.API.CONSUMER.CREATE.incise_liver", "$JS.API.CONSUMER.CREATE.incise_liver.>"],
        subscribe: ["_INBOX.>", "incise.liver.live"] } },
    { user: "kidney", password: "writes", permissions: {
        publish: ["incise.kidney.>", "$JS.API.>", "$KV.incise_sessions.kidney.>"], subscribe: ["_INBOX.>"] } }
  ]
}
"""


class SecurityTest(ClusterTest):
    def setUp(self):
        super().setUp()
        self.ca, self.other_ca = self.authority("ca"), self.authority("other")
        key, request, certificate = (str(self.folder / f"server.{end}") for end in ("key", "csr", "pem"))
        extension = self.folder / "server.ext"
        extension.write_text("subjectAltName=IP:127.0.0.1,DNS:localhost\n")
        self.openssl("req", "-newkey", "rsa:2048", "-nodes", "-keyout", key, "-out", request, "-subj", "/CN=localhost")
        self.openssl("x509", "-req", "-in", request, "-CA", self.ca, "-CAkey", self.ca.replace(".pem", ".key"), "-CAcreateserial",
                     "-days", "2", "-extfile", str(extension), "-out", certificate)
        self.tls = f'tls {{ cert_file: "{certificate}", key_file: "{key}" }}\n'

    def openssl(self, *arguments):
        subprocess.run(["openssl", *arguments], check=True, capture_output=True)

    def authority(self, name):
        path = str(self.folder / f"{name}.pem")
        self.openssl("req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", f"/CN={name}", "-keyout",
                     path.replace(".pem", ".key"), "-out", path)
        return path

    def who(self, user, password):
        path = self.folder / f"{user}-{password}.json"
        path.write_text(json.dumps({"user": user, "password": password}))
        return str(path)

    def server(self, nats, **cluster):
        keys = {"nats": f"tls://127.0.0.1:{nats.port}", "name": "liver", "ca_file": self.ca,
                "credentials_file": self.who("liver", "writes"), **cluster}
        if "url" in keys:
            keys["nats"] = keys.pop("url")
        return self.incised(keys, name=f"incised-{len(self.started)}").start()

    def trouble(self, nats, **cluster):
        server = self.server(nats, **cluster)
        text = wait_for("it says what is wrong", lambda: server.cluster()["trouble"].replace("not connected yet", ""))
        self.assertGreater(stroke(server), 0, "the session goes on")
        self.assertIn(text, server.log())
        return text

    def doctor(self, server):
        run = subprocess.run([BIN / "incise", "doctor", "--config", server.config, "--json"], capture_output=True, text=True, timeout=60)
        return next(f for f in json.loads(run.stdout)["findings"] if f["what"] == "NATS")

    def test_with_everything_right(self):
        nats = self.nats(more=self.tls + USERS)
        server = self.server(nats)
        wait_for("it publishes: " + server.log(), lambda: server.cluster()["connected"])
        revision = stroke(server)
        link = Nats(nats.port, "audience", "reads", self.ca)
        self.addCleanup(link.close)

        def there():
            reader = StreamReader(link, "liver").read()
            return reader.revision == revision

        wait_for("a reader who may read comes to its state", there)
        wait_for("it is listed", lambda: json.loads(server.get("/sessions")))
        self.assertEqual(self.doctor(server)["verdict"], "good")
        # Who may not, reads nothing: without TLS, a password, or this session.
        with self.assertRaises((ConnectionError, OSError, ssl.SSLError)):
            Nats(nats.port, "audience", "reads")
        with self.assertRaises(ConnectionError):
            Nats(nats.port, ca=self.ca)
        with self.assertRaises(ConnectionError):
            Nats(nats.port, "audience", "wrongly", self.ca)
        other = Nats(nats.port, "audience", "reads", self.ca)
        self.addCleanup(other.close)
        with self.assertRaises(PermissionError):
            other.request("$JS.API.STREAM.MSG.GET.incise_kidney", b'{"seq":1}')
        kidney = Nats(nats.port, "kidney", "writes", self.ca)
        self.addCleanup(kidney.close)
        kidney.subscribe("incise.liver.>")
        with self.assertRaises(PermissionError):
            kidney.message()

    def test_the_permissions_of_the_page_are_enough(self):
        page = (Path(__file__).parents[2] / "server/cluster/NATS.md").read_text()
        users = "authorization {" + page.split("\nauthorization {", 1)[1].split("\n}\n", 1)[0] + "\n}\n"
        nats = self.nats(more=self.tls + users)
        url = f"tls://127.0.0.1:{nats.port}"
        server = self.incised({"nats": url, "name": "liver", "ca_file": self.ca, "credentials_file": self.who("liver", "..."), "failover": True,
                               "lease_s": 3}, capture=self.folder / "session.capture").start()
        who = self.who("relay", "...")
        relay = Relay(self.folder, ["--nats", url, "--session", "liver", "--credentials", who, "--ca", self.ca])
        self.started.append(relay)
        relay.start()
        stroke(server)
        viewer = Viewer(relay.tcp)
        self.addCleanup(viewer.client.close)
        wait_for("a viewer at the relay is there", lambda: viewer.is_at(server))

        def both_are_listed():
            run = subprocess.run([BIN / "incise", "sessions", url, "--credentials", who, "--ca", self.ca, "--json"], capture_output=True, text=True,
                                 timeout=30)
            self.assertEqual(run.returncode, 0, run.stderr)
            return {place["kind"] for session in json.loads(run.stdout) for place in session["places"]} == {"server", "relay"}

        wait_for("both are listed", both_are_listed)
        self.assertEqual(server.stop(), 0)
        for log in (server.log(), relay.log()):
            self.assertNotIn("ermission", log)

    def test_a_wrong_password(self):
        nats = self.nats(more=self.tls + USERS)
        text = self.trouble(nats, credentials_file=self.who("liver", "guessed"))
        self.assertIn("it refuses the credentials in", text)
        self.assertIn("it wants credentials, and none were given", self.trouble(nats, credentials_file=""))

    def test_a_wrong_authority(self):
        nats = self.nats(more=self.tls + USERS)
        text = self.trouble(nats, ca_file=self.other_ca)
        self.assertIn("TLS", text)
        self.assertIn("issuer", text)
        text = self.trouble(nats, ca_file="")
        self.assertIn("ca_file", text)

    def test_no_tls_there_or_here(self):
        nats = self.nats()
        self.assertIn("it has no TLS", self.trouble(nats, credentials_file=""))
        nats.kill()
        nats.config.write_text(nats.config.read_text() + self.tls)
        nats.start()
        self.assertIn("it wants TLS: write tls://", self.trouble(nats, url=nats.url, credentials_file="", ca_file=""))

    def test_a_subject_that_is_not_permitted(self):
        nats = self.nats(more=self.tls + USERS)
        text = self.trouble(nats, credentials_file=self.who("kidney", "writes"))
        self.assertIn("ermissions", text)
        self.assertIn("incise.liver.", text)

    def test_the_lease_says_at_once_what_waiting_does_not_mend(self):
        nats = self.nats(more=self.tls + USERS)
        server = self.incised({"nats": f"tls://127.0.0.1:{nats.port}", "name": "liver", "ca_file": self.ca, "failover": True,
                               "credentials_file": self.who("liver", "guessed")}, capture=self.folder / "session.capture")
        server.start(wait=False)
        self.assertEqual(server.end(), 1)
        self.assertIn("it refuses the credentials", server.log())


if __name__ == "__main__":
    main()
