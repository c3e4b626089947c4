// incised and incise as their users run them: a configuration, a server, a streamed motion, watchers, the capture.

#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <cmath>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <mutex>
#include <nlohmann/json.hpp>
#include <random>
#include <thread>

#include "client/client.hpp"
#include "client/contact_renderer.hpp"
#include "tests/e2e/process.hpp"
#include "tests/stream/mini_loop.hpp"
#include "tests/stream/raw_peer.hpp"

namespace incise::e2e {
namespace {

namespace fs = std::filesystem;

class ProgramsTest : public ::testing::Test {
 protected:
  void SetUp() override {
    for (const char* name : {"incised", "incise"}) {
      if (!have_program(name)) GTEST_SKIP() << name << " has not been built";
    }
    fs::create_directories(directory);
    // A cylinder's axis may lie anywhere; the motion follows what the server says of its mesh.
    std::ofstream(directory / "server.json") << R"({
      "mesh": {"phantom": "slab", "target_tets": 4000},
      "blade": {"heel": [0, 0, 0], "tip": [0, 0, -1]},
      "cut": {"speed_limit_m_s": 50},
      "listen": {"tcp_port": 0, "http_port": 0},
      "loop": {"realtime_priority": 0, "lock_memory": false},
      "capture": {"path": "run.incise"},
      "log": {"level": "warning"}
    })";
  }
  ~ProgramsTest() override { fs::remove_all(directory); }

  std::unique_ptr<Process> start(bool resume = false) {
    std::vector<std::string> arguments{"incised", "--config", file("server.json")};
    if (resume) arguments.emplace_back("--resume");
    auto server = std::make_unique<Process>(arguments);
    const std::string line = server->line("listening ");
    tcp_port = port_after(line, "tcp=");
    http_port = port_after(line, "http=");
    EXPECT_NE(tcp_port, 0) << line;
    EXPECT_NE(http_port, 0) << line;
    return server;
  }
  std::string file(const std::string& name) const { return (directory / name).string(); }
  std::string tcp() const { return "127.0.0.1:" + std::to_string(tcp_port); }
  std::string web() const { return "ws://127.0.0.1:" + std::to_string(http_port); }

  // A motion right through the body, as a file: along x, the blade straight down.
  void write_motion(const protocol::Box& box, double share_of_y, int poses = 400) {
    const double y = box.min.y + share_of_y * (box.max.y - box.min.y);
    const double margin = 0.1 * (box.max.x - box.min.x);
    std::ofstream csv(directory / "motion.csv");
    csv.precision(12);
    csv << "t_s,x_m,y_m,z_m,qw,qx,qy,qz,button\n";
    for (int i = 0; i < poses; ++i) {
      const double s = static_cast<double>(i) / (poses - 1);
      csv << 0.002 * i << ',' << box.min.x - margin + s * (box.max.x - box.min.x + 2 * margin) << ',' << y
          << ',' << box.max.z + margin << ",1,0,0,0," << (i + 1 < poses) << '\n';
    }
  }
  nlohmann::json stream(const std::string& speed, const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments{"incise", "stream", file("motion.csv"), "--to", tcp(), "--speed",
                                       speed,    "--json"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    Process player(arguments);
    const std::string printed = player.line("{");
    EXPECT_EQ(player.wait(), 0);
    return nlohmann::json::parse(printed);
  }
  void run_python(const std::string& script);
  std::string bytes(const std::string& name) const {
    std::ifstream in(directory / name, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(in), {});
  }

  fs::path directory = fs::temp_directory_path() / ("incise_e2e_" + std::to_string(::getpid()));
  std::uint16_t tcp_port = 0, http_port = 0;
};

TEST_F(ProgramsTest, AStreamedMotionCanBeginWithAnUncutBody) {
  const auto server = start();
  client::Options options;
  options.view = protocol::View::Surface;  // as incise stream: each view has a session of its own
  const auto viewer = client::Client::connect("127.0.0.1", tcp_port, options);
  write_motion(viewer->welcome().mesh.box, 0.5);
  const auto first = stream("1");
  const auto again = stream("1", {"--reset"});
  EXPECT_NE(again["session"], first["session"]);
  EXPECT_EQ(again["first_revision"], 0);
  EXPECT_EQ(again["revision"], first["revision"]);
  ASSERT_TRUE(viewer->wait_for_revision(again["revision"], 20));
  EXPECT_EQ(std::to_string(viewer->welcome().session), again["session"]);
}

TEST_F(ProgramsTest, AStreamedMotionCutsAndEverybodySeesTheSame) {
  const auto server = start();
  const auto viewer = client::Client::connect("127.0.0.1", tcp_port);
  write_motion(viewer->welcome().mesh.box, 0.5);
  Process watcher({"incise", "watch", web(), "--until-revision", "3", "--for", "60", "--json"});
  const auto summary = stream("1");
  EXPECT_EQ(summary["poses_sent"], 400);
  EXPECT_EQ(summary["accepted"], 400);
  EXPECT_TRUE(summary["settled"]);
  const std::uint64_t revision = summary["revision"];
  ASSERT_GE(revision, 3u);
  EXPECT_EQ(watcher.wait(), 0);

  ASSERT_TRUE(viewer->wait_for_revision(revision, 20));
  const std::uint64_t hash = viewer->read([](const protocol::Replica& m) { return m.compute_state_hash(); });
  EXPECT_EQ(hash, viewer->read([](const protocol::Replica& m) { return m.state_hash(); }));
  for (const auto& [address, name] : {std::pair(tcp(), "tcp.bin"), std::pair(web(), "web.bin")}) {
    Process watch({"incise", "watch", address, "--until-revision", std::to_string(revision), "--for", "20",
                   "--save", file(name), "--json"});
    EXPECT_EQ(watch.wait(), 0);
  }
  EXPECT_GT(bytes("tcp.bin").size(), 10'000u);
  EXPECT_EQ(bytes("tcp.bin"), bytes("web.bin"));

  EXPECT_NE(stream::http(http_port, "/healthz").find("\"revision\":" + std::to_string(revision)),
            std::string::npos);
  EXPECT_NE(stream::http(http_port, "/metrics").find("incise_stream_revision " + std::to_string(revision)),
            std::string::npos);
  const std::string stats = stream::http(http_port, "/stats");
  EXPECT_FALSE(nlohmann::json::parse(stats.substr(stats.find("\r\n\r\n") + 4)).empty());

  server->signal(SIGTERM);
  EXPECT_EQ(server->wait(), 0);
  Process replay({"incise", "replay", file("run.incise"), "--verify"});
  EXPECT_EQ(replay.wait(), 0);
}

TEST_F(ProgramsTest, AWatcherOfAServerThatStandsStillSaysSo) {
  const auto server = start();
  Process watch({"incise", "watch", tcp()});
  EXPECT_NE(watch.line("revision 0").find(" tets "), std::string::npos);
  server->signal(SIGSTOP);
  EXPECT_FALSE(watch.line("revision 0  no word from the server for ").empty());
  server->signal(SIGCONT);
  std::string line;
  do {
    line = watch.line("revision 0");
  } while (line.find("no word") != std::string::npos);
  EXPECT_EQ(watch.line("pose to cut"), "pose to cut -  cut to here - (p50/p99)");
  watch.signal(SIGINT);
  EXPECT_EQ(watch.wait(), 0);
}

TEST_F(ProgramsTest, AKilledServerGoesOnWhereItWas) {
  auto server = start();
  client::Options options;
  options.reconnect = true;
  auto viewer = client::Client::connect("127.0.0.1", tcp_port, options);
  write_motion(viewer->welcome().mesh.box, 0.4);
  const std::uint64_t revision = stream("2")["revision"];
  ASSERT_TRUE(viewer->wait_for_revision(revision, 20));
  const std::uint64_t session = viewer->welcome().session;
  const auto held = viewer->read([](const protocol::Replica& m) { return m.canonical_bytes(); });
  std::this_thread::sleep_for(std::chrono::milliseconds(500));  // the journal's group commit
  server->signal(SIGKILL);
  EXPECT_EQ(server->wait(), 128 + SIGKILL);
  viewer->close();

  server = start(true);
  viewer = client::Client::connect("127.0.0.1", tcp_port, options);
  EXPECT_EQ(viewer->welcome().session, session);
  ASSERT_TRUE(viewer->wait_for_revision(revision, 20));
  EXPECT_EQ(viewer->read([](const protocol::Replica& m) { return m.canonical_bytes(); }), held);
  write_motion(viewer->welcome().mesh.box, 0.6);
  EXPECT_GT(stream("0")["revision"], revision);
  server->signal(SIGINT);
  EXPECT_EQ(server->wait(), 0);
}

// A script of ours: it leads to a revision and saves what it holds, which is what a C++ client holds, too.
void ProgramsTest::run_python(const std::string& script) {
  const auto server = start();
  const auto viewer = client::Client::connect("127.0.0.1", tcp_port);
  write_motion(viewer->welcome().mesh.box, 0.5);
  Process session({"/usr/bin/env",
                   "PYTHONPATH=" + std::string(INCISE_SOURCE_DIR) + "/client/python:" + INCISE_PYTHON_DIR,
                   "/usr/bin/python3", std::string(INCISE_SOURCE_DIR) + "/tests/e2e/" + script,
                   std::to_string(tcp_port), file("motion.csv"), file("python.bin")});
  const std::string printed = session.rest();
  ASSERT_EQ(session.wait(), 0);
  const std::uint64_t revision = std::stoull(printed);
  ASSERT_TRUE(viewer->wait_for_revision(revision, 20));
  ASSERT_EQ(viewer->revision(), revision);
  const auto held = viewer->read([](const protocol::Replica& m) { return m.canonical_bytes(); });
  EXPECT_EQ(bytes("python.bin"), std::string(reinterpret_cast<const char*>(held.data()), held.size()));
}

TEST_F(ProgramsTest, ThePythonClientCutsAndHoldsTheSame) {
  run_python("python_session.py");
}

TEST_F(ProgramsTest, ThePythonClientDeformsTheBodyAndHoldsTheSame) {
  run_python("python_simulator.py");
}

// An operator that leans its blade on the body gets forces within the limits, and planes that it can render. On a loaded
// machine the poses may come so unsteadily that the safety chain latches the force off: then a new session begins.
TEST_F(ProgramsTest, AnOperatorFeelsTheTissue) {
  const auto server = start();
  std::mutex mutex;
  std::vector<protocol::Force> forces;
  client::ContactRenderer renderer;
  client::Callbacks callbacks;
  const auto now_ns = [] { return std::chrono::steady_clock::now().time_since_epoch().count(); };
  callbacks.on_force = [&](const protocol::Force& force) {
    renderer.take(force, now_ns());
    const std::scoped_lock lock(mutex);
    forces.push_back(force);
  };
  const auto size = [](const protocol::Vec3& v) { return std::sqrt(v.x * v.x + v.y * v.y + v.z * v.z); };
  client::Options options;
  options.role = protocol::Role::Operator;
  bool felt = false, planes = false, rendered = false;
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(40);
  while (!(felt && planes && rendered) && std::chrono::steady_clock::now() < deadline) {
    const auto blade = client::Client::connect("127.0.0.1", tcp_port, options, callbacks);
    const protocol::Box box = blade->welcome().mesh.box;
    const auto begun = now_ns();
    bool latched = false;
    while (!latched && !(felt && planes && rendered) && std::chrono::steady_clock::now() < deadline) {
      const double in = std::min(0.004, 2e-3 * 1e-9 * static_cast<double>(now_ns() - begun));
      protocol::PoseSample pose;
      pose.source_ns = now_ns();
      pose.position = {box.min.x - 1e-4 + in, 0.5 * (box.min.y + box.max.y) + 1e-3 * in, box.max.z + 0.01};
      pose.orientation = {1, 0, 0, 0};
      blade->send_poses(std::span(&pose, 1));
      rendered = size(renderer.force(pose.position, now_ns())) > 0 || rendered;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
      const std::scoped_lock lock(mutex);
      for (const protocol::Force& force : forces) {
        EXPECT_LE(size(force.force_n), 3.3 + 1e-9);
        felt = felt || force.force_n.x < 0;
        planes = planes || (force.contact && force.contact->normal.x < -0.5);
        latched = latched || force.latched_off;
      }
      forces.clear();
    }
  }
  EXPECT_TRUE(felt) << "out of the body, against the motion";
  EXPECT_TRUE(planes);
  EXPECT_TRUE(rendered);
  server->signal(SIGTERM);
  EXPECT_EQ(server->wait(), 0);
}

TEST_F(ProgramsTest, MalformedMessagesDoNotStopTheServer) {
  const auto server = start();
  std::mt19937_64 random(11);
  for (int i = 0; i < 120; ++i) {
    stream::RawPeer peer(i % 4 == 3 ? http_port : tcp_port);
    ASSERT_TRUE(peer.connected()) << "case " << i;
    std::vector<std::byte> garbage(1 + random() % 300);
    for (std::byte& b : garbage) b = std::byte(random() & 0xff);
    if (i % 2 == 0 && garbage.size() > 4) {
      const auto size = static_cast<std::uint32_t>(garbage.size() - 4);  // at least the length is right
      std::memcpy(garbage.data(), &size, 4);
    }
    peer.send(garbage);
    if (i % 3 == 0) peer.vanish();
  }
  ASSERT_TRUE(server->running());
  const auto viewer = client::Client::connect("127.0.0.1", tcp_port);
  EXPECT_TRUE(viewer->wait_for_revision(0, 20));
  server->signal(SIGTERM);
  EXPECT_EQ(server->wait(), 0);
}

}  // namespace
}  // namespace incise::e2e
