#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <thread>

#include "server/stream/origin.hpp"
#include "tests/stream/mini_loop.hpp"
#include "tests/stream/raw_peer.hpp"

namespace incise::stream {
namespace {

namespace fs = std::filesystem;

std::string status_of(const std::string& answer) {
  return answer.substr(0, answer.find('\r'));
}
std::string body_of(const std::string& answer) {
  const auto end = answer.find("\r\n\r\n");
  return end == std::string::npos ? "" : answer.substr(end + 4);
}

class HttpTest : public ::testing::Test {
 protected:
  HttpTest() {
    fs::create_directories(site);
    std::ofstream(site / "index.html") << "<!doctype html><title>Incise</title>";
    std::ofstream(site.parent_path() / "secret.txt") << "classified";
    StreamConfig config = test_config();
    config.viewer_directory = site;
    Providers providers;
    providers.stats_json = [] { return std::string("{\"frames\":1}"); };
    providers.trouble = [this] { return std::string(stands ? "the loop has not advanced for 4 s" : ""); };
    providers.metrics_text = [] { return std::string("incise_frames_total 1\n"); };
    providers.recording = [this] { return RecordingNow{recording, "/var/disk.capture: full"}; };
    providers.documents["/surface"] = {"application/octet-stream",
                                       std::make_shared<std::string>(std::string("a\0b", 3))};
    providers.documents["/surface/0.png"] = {"image/png", std::make_shared<std::string>("picture")};
    test = std::make_unique<TestServer>(2, config, providers);
  }
  ~HttpTest() override {
    test.reset();
    fs::remove_all(site.parent_path());
  }
  std::uint16_t port() const { return test->server.http_port(); }

  fs::path site = fs::temp_directory_path() / ("incise_http_" + std::to_string(::getpid())) / "site";
  std::unique_ptr<TestServer> test;
  std::atomic<bool> stands{false};
  std::atomic<protocol::Recording> recording{protocol::Recording::On};
};

// What is in memory under these paths, letter by letter: a request names no file.
TEST_F(HttpTest, ServesTheSurfaceAndNothingBesideIt) {
  const std::string surface = http(port(), "/surface");
  EXPECT_EQ(status_of(surface), "HTTP/1.1 200 OK");
  EXPECT_NE(surface.find("application/octet-stream"), std::string::npos);
  EXPECT_EQ(body_of(surface), std::string("a\0b", 3));
  EXPECT_EQ(body_of(http(port(), "/surface/0.png?v=1")), "picture");
  for (const char* path :
       {"/surface/", "/surface/1.png", "/surface/0.PNG", "/surface/./0.png", "/surface/../surface",
        "/surface/../../secret.txt", "/surface/%2e%2e/secret.txt", "/surface//0.png", "/surface/0.png/",
        "/surface/%30.png", "/surface/0.png%00", "//surface"}) {
    EXPECT_EQ(status_of(http(port(), path)), "HTTP/1.1 404 Not Found") << path;
  }
}

TEST_F(HttpTest, TellsHowItIs) {
  test->cut();
  const std::string health = http(port(), "/healthz");
  EXPECT_EQ(status_of(health), "HTTP/1.1 200 OK");
  EXPECT_NE(body_of(health).find("\"revision\":" + std::to_string(test->loop.revision())), std::string::npos);
  EXPECT_EQ(body_of(http(port(), "/stats")), "{\"frames\":1}");
  const std::string metrics = body_of(http(port(), "/metrics"));
  EXPECT_EQ(metrics.rfind("incise_frames_total 1\n", 0), 0u);
  EXPECT_NE(metrics.find("\nincise_stream_revision " + std::to_string(test->loop.revision()) + "\n"),
            std::string::npos);
}

TEST_F(HttpTest, IsNotWellWhereTheLoopStands) {
  stands = true;
  const std::string health = http(port(), "/healthz");
  EXPECT_EQ(status_of(health), "HTTP/1.1 503 Service Unavailable");
  EXPECT_EQ(body_of(health).rfind("{\"status\":\"the loop has not advanced for 4 s\",", 0), 0u) << health;
  stands = false;
  EXPECT_EQ(status_of(http(port(), "/healthz")), "HTTP/1.1 200 OK");
}

// It cuts all the same: who watches it must not restart it, but is told, without the path.
TEST_F(HttpTest, SaysThatPosesAreNotRecordedAndWorksAllTheSame) {
  const auto says = [&](const std::string& begin) {
    for (int i = 0; i < 500; ++i) {
      const std::string health = http(port(), "/healthz");
      EXPECT_EQ(status_of(health), "HTTP/1.1 200 OK");
      if (body_of(health).rfind(begin, 0) == 0) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return false;
  };
  EXPECT_TRUE(says(R"({"status":"ok","recording":"on",)"));
  recording = protocol::Recording::Stopped;
  EXPECT_TRUE(says(R"({"status":"poses are not recorded","recording":"stopped","revision")"));
  recording = protocol::Recording::Off;
  EXPECT_TRUE(says(R"({"status":"ok","recording":"off",)"));
}

TEST_F(HttpTest, WithoutAPageItSaysWhereOneWouldBe) {
  EXPECT_EQ(status_of(http(port(), "/")), "HTTP/1.1 200 OK");
  fs::remove(site / "index.html");
  const std::string answer = http(port(), "/");
  EXPECT_EQ(status_of(answer), "HTTP/1.1 404 Not Found");
  EXPECT_NE(body_of(answer).find("listen.viewer_directory"), std::string::npos) << answer;
  EXPECT_EQ(body_of(http(port(), "/none")), "not found\n");
}

TEST_F(HttpTest, SendsWhatIsPackedToWhoTakesIt) {
  std::ofstream(site / "page.js") << "let plain;";
  std::ofstream(site / "page.js.gz") << "as if packed";
  const std::string packed = http(port(), "/page.js", "GET", "Accept-Encoding: gzip, br\r\n");
  EXPECT_EQ(status_of(packed), "HTTP/1.1 200 OK");
  EXPECT_NE(packed.find("Content-Encoding: gzip"), std::string::npos);
  EXPECT_NE(packed.find("Content-Type: text/javascript; charset=utf-8"), std::string::npos);
  EXPECT_NE(packed.find("Vary: Accept-Encoding"), std::string::npos);
  EXPECT_EQ(body_of(packed), "as if packed");
  const std::string plain = http(port(), "/page.js");
  EXPECT_EQ(plain.find("Content-Encoding"), std::string::npos);
  EXPECT_EQ(body_of(plain), "let plain;");
  // What a cache holds of the one is no answer for the other.
  const auto etag_of = [](const std::string& answer) {
    const auto at = answer.find("ETag: ");
    return at == std::string::npos ? "" : answer.substr(at + 6, answer.find('\r', at) - at - 6);
  };
  EXPECT_NE(etag_of(packed), etag_of(plain));
  const std::string again =
      http(port(), "/page.js", "GET", "Accept-Encoding: gzip\r\nIf-None-Match: " + etag_of(packed) + "\r\n");
  EXPECT_EQ(status_of(again), "HTTP/1.1 304 Not Modified");
}

TEST_F(HttpTest, ListsNoCapturesWhereThereIsNoLibrary) {
  EXPECT_EQ(body_of(http(port(), "/captures")), "[]\n");
}

TEST_F(HttpTest, ServesTheViewer) {
  const std::string page = http(port(), "/");
  EXPECT_EQ(status_of(page), "HTTP/1.1 200 OK");
  EXPECT_NE(page.find("Content-Type: text/html; charset=utf-8"), std::string::npos);
  EXPECT_EQ(body_of(page), "<!doctype html><title>Incise</title>");
  const auto at = page.find("ETag: ");
  ASSERT_NE(at, std::string::npos);
  const std::string etag = page.substr(at + 6, page.find('\r', at) - at - 6);
  const std::string again = http(port(), "/", "GET", "If-None-Match: " + etag + "\r\n");
  EXPECT_EQ(status_of(again), "HTTP/1.1 304 Not Modified");
  EXPECT_EQ(body_of(again), "");
  const std::string head = http(port(), "/", "HEAD");
  EXPECT_EQ(status_of(head), "HTTP/1.1 200 OK");
  EXPECT_NE(head.find("Content-Length: 36"), std::string::npos);
  EXPECT_EQ(body_of(head), "");
}

TEST_F(HttpTest, RefusesTheRest) {
  for (const char* target :
       {"/../secret.txt", "/%2e%2e/secret.txt", "/..%2Fsecret.txt", "/none", "//etc/passwd"}) {
    const std::string answer = http(port(), target);
    EXPECT_EQ(status_of(answer), "HTTP/1.1 404 Not Found") << target;
    EXPECT_EQ(answer.find("classified"), std::string::npos) << target;
  }
  EXPECT_EQ(status_of(http(port(), "/", "POST")), "HTTP/1.1 405 Method Not Allowed");
  EXPECT_EQ(status_of(http(port(), "/ws")), "HTTP/1.1 426 Upgrade Required");
  EXPECT_EQ(status_of(http(port(), "/", "GET", "X: " + std::string(40'000, 'x') + "\r\n")).substr(0, 12),
            "HTTP/1.1 431");
  EXPECT_EQ(status_of(http(port(), "/stats", "POST", "Content-Length: 99999999999\r\n")),
            "HTTP/1.1 413 Payload Too Large");
  RawPeer garbage(port());
  garbage.send(std::string_view("\x16\x03\x01\x02\0\x01nonsense\r\n\r\n", 18));
  EXPECT_EQ(garbage.read_all().substr(0, 12), "HTTP/1.1 400");
  EXPECT_EQ(status_of(http(port(), "/healthz")), "HTTP/1.1 200 OK");
}

std::string upgrade(std::uint16_t port, const std::string& headers, const std::string& host,
                    const std::string& key = "dGhlIHNhbXBsZSBub25jZQ==") {
  RawPeer peer(port);
  peer.send("GET /ws HTTP/1.1\r\nHost: " + host +
            "\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: " +
            key + "\r\n" + headers + "\r\n");
  return status_of(peer.read_all(12));
}

// A compressed message could grow a thousandfold on reading. Compression is not granted, and who sends such a message all
// the same is disconnected before anything is unpacked.
TEST_F(HttpTest, CompressionIsNotGrantedAndItsMessagesAreRefused) {
  RawPeer peer(port());
  peer.send("GET /ws HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port()) +
            "\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
            "Sec-WebSocket-Extensions: permessage-deflate; client_max_window_bits\r\n\r\n");
  // Binary, final, marked as compressed (RSV1), masked with zeros: zeros, deflated a thousandfold.
  const std::string deflated("\xec\xc1\x01\x0d\x00\x00\x00\xc2\xa0\xf7\x4f\x6d\x0f\x07\x14\x00", 16);
  const std::string frame =
      std::string("\xc2") + static_cast<char>(0x80 | deflated.size()) + std::string(4, '\0') + deflated;
  const std::string answer = peer.read_head();  // what is sent before may count as part of the request
  ASSERT_NE(answer.find("\r\n\r\n"), std::string::npos) << answer;
  peer.send(frame);
  const std::string rest = peer.read_all();  // to the end that the server makes, though this end stays
  EXPECT_EQ(rest.substr(0, 4), std::string("\x88\x02\x03\xea", 4)) << "no closing frame for a protocol error";
  EXPECT_EQ(status_of(answer), "HTTP/1.1 101 Switching Protocols");
  EXPECT_EQ(answer.find("permessage-deflate"), std::string::npos);
  EXPECT_TRUE(eventually([&] { return test->server.counters().connections == 0; }));
  EXPECT_EQ(test->server.counters().messages_in, 0u);
}

TEST_F(HttpTest, ForeignPagesGetNoWebSocket) {
  const std::string host = "127.0.0.1:" + std::to_string(port());
  EXPECT_EQ(upgrade(port(), "", host).substr(0, 12), "HTTP/1.1 101");
  EXPECT_EQ(upgrade(port(), "Origin: http://" + host + "\r\n", host).substr(0, 12), "HTTP/1.1 101");
  EXPECT_EQ(upgrade(port(), "Origin: http://evil.example\r\n", host).substr(0, 12), "HTTP/1.1 403");
  EXPECT_EQ(upgrade(port(), "Origin: null\r\n", host).substr(0, 12), "HTTP/1.1 403");
}

TEST_F(HttpTest, AWebSocketsKeyIsSixteenBytesInBase64) {
  const std::string host = "127.0.0.1:" + std::to_string(port());
  for (const char* key :
       {"x", "", "dGhlIHNhbXBsZSBub25jZQ=", "dGhlIHNhbXBsZSBub25jZQAA", "dGhlIHNhbXBsZSBub25jZSE=",
        "dGhlIHNhbXBsZSBub25j!Q==", "dGhlIHNhbXBsZSBub25jZQ==dGhlIHNhbXBsZSBub25jZQ=="}) {
    EXPECT_EQ(upgrade(port(), "", host, key).substr(0, 12), "HTTP/1.1 400") << key;
  }
}

TEST(OriginAllowed, IsTheServersOwnOrAListedOne) {
  EXPECT_TRUE(origin_allowed("", "127.0.0.1:7462", {}));
  EXPECT_TRUE(origin_allowed("http://127.0.0.1:7462", "127.0.0.1:7462", {}));
  EXPECT_TRUE(origin_allowed("http://localhost:7462", "localhost:7462", {}));
  EXPECT_TRUE(origin_allowed("https://[::1]:7462", "[::1]:7462", {}));
  EXPECT_TRUE(origin_allowed("https://10.0.0.5", "10.0.0.5", {}));
  EXPECT_FALSE(origin_allowed("http://localhost:8080", "localhost:7462", {}));
  // A name that its owner has pointed at this machine.
  EXPECT_FALSE(origin_allowed("http://evil.example:7462", "evil.example:7462", {}));
  EXPECT_TRUE(origin_allowed("http://lab.example", "127.0.0.1:7462", {"http://lab.example"}));
  EXPECT_FALSE(origin_allowed("http://lab.example.evil", "127.0.0.1:7462", {"http://lab.example"}));
  EXPECT_TRUE(origin_allowed("http://anything", "127.0.0.1:7462", {"*"}));
}

}  // namespace
}  // namespace incise::stream
