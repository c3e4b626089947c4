// incised with sources of poses on the network: OpenIGTLink peers, which are processes on that library alone, and a
// stand-in for Haply's service.

#include <gtest/gtest.h>
#include <sys/ptrace.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cmath>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>
#include <thread>

#include "client/client.hpp"
#include "tests/e2e/process.hpp"
#include "tests/input/haply/inverse_service.hpp"
#include "tests/stream/mini_loop.hpp"
#include "tests/stream/raw_peer.hpp"

namespace incise::e2e {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using stream::eventually;

class NetworkInput : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(directory); }
  ~NetworkInput() override { fs::remove_all(directory); }

  std::string file(const std::string& name) const { return (directory / name).string(); }
  // `more`: further members of the configuration.
  void start(const std::string& more) {
    // Wall time means nothing on a busy machine: no pause ends a stroke here.
    std::ofstream(file("server.json")) << R"({"mesh": {"phantom": "liver", "target_tets": 12000},
      "blade": {"heel": [0, 0, 0], "tip": [0, 0, -0.12]},
      "cut": {"gap_limit_s": 3600, "speed_limit_m_s": 100},
      "devices": {"enabled": false},
      "listen": {"tcp_port": 0, "http_port": 0},
      "loop": {"realtime_priority": 0, "lock_memory": false},
      "capture": {"path": "run.capture"}, "log": {"level": "warning"}, )" +
                                              more + "}";
    server = std::make_unique<Process>(std::vector<std::string>{"incised", "--config", file("server.json")});
    const std::string line = server->line("listening ", 120);
    tcp_port = port_after(line, "tcp=");
    http_port = port_after(line, "http=");
    igtl_port = port_after(line, "openigtlink=");
    ASSERT_NE(tcp_port, 0) << line;
  }
  json stats() const {
    const std::string answer = stream::http(http_port, "/stats");
    return json::parse(answer.substr(answer.find("\r\n\r\n") + 4));
  }
  // Once the loop has taken so many poses, and the stroke's last batch is cut: after its source has gone.
  bool settled(std::uint64_t poses) const {
    return eventually([&] {
      const json s = stats();
      return s["poses"]["accepted"].get<std::uint64_t>() +
                     s["poses"]["accepted as a new stroke"].get<std::uint64_t>() >=
                 poses &&
             s["sources"] == 0 && s["backlog"]["batches"] == 0 && s["backlog"]["poses"] == 0;
    });
  }
  std::size_t pieces() const {
    const auto viewer = client::Client::connect("127.0.0.1", tcp_port);
    const std::uint64_t revision = stats()["revision"];
    EXPECT_TRUE(viewer->wait_for_revision(revision, 60));
    return viewer->read([](const protocol::Replica& mesh) {
      std::set<std::uint32_t> names;
      for (std::uint32_t t = 0; t < mesh.tet_slots(); ++t) {
        if (mesh.alive(t)) names.insert(mesh.piece(t));
      }
      return names.size();
    });
  }
  void stop_and_replay() {
    server->signal(SIGTERM);
    EXPECT_EQ(server->wait(), 0);
    Process replay({"incise", "replay", file("run.capture"), "--verify"});
    EXPECT_EQ(replay.wait(120), 0);
  }

  fs::path directory = fs::temp_directory_path() / ("incise_network_" + std::to_string(::getpid()));
  std::unique_ptr<Process> server;
  std::uint16_t tcp_port = 0, http_port = 0, igtl_port = 0;
};

#ifdef INCISE_OPENIGTLINK

constexpr int kPoses = 600;

class OpenIgtLinkPeer : public NetworkInput,
                        public ::testing::WithParamInterface<std::pair<const char*, const char*>> {};

TEST_P(OpenIgtLinkPeer, ThatConnectsCutsTheLiverInTwoAndSeesIt) {
  start(R"("openigtlink": {"port": 0, "silence_s": 3600})");
  const auto [type, version] = GetParam();
  const std::string port = std::to_string(igtl_port);
  {
    Process peer({"openigtlink_peer", "send", port, type, version, std::to_string(kPoses)});
    ASSERT_EQ(peer.line("sent", 120), "sent");
    // It is still there, and so is its blade.
    ASSERT_TRUE(eventually([&] { return stats()["openigtlink"]["poses"] == kPoses; })) << stats();
    EXPECT_EQ(stats()["openigtlink"]["peers"][0]["sources"], json::array({"Scalpel"}));
  }
  ASSERT_TRUE(settled(kPoses)) << stats();
  EXPECT_EQ(stats()["strokes"], 1);
  EXPECT_EQ(pieces(), 2u);
  const json link = stats()["openigtlink"];
  for (const char* fault : {"bad_headers", "bad_crc", "bad_shape", "bad_values", "no_blade", "refused"})
    EXPECT_EQ(link[fault], 0) << fault;
  Process watcher({"openigtlink_peer", "watch", port});
  const std::string seen = watcher.line("surface ", 120);
  EXPECT_EQ(seen.find("surface good points "), 0u) << seen;
  EXPECT_NE(seen.find(" pieces 2 "), std::string::npos) << seen;
  EXPECT_EQ(seen.find(" cut 0 "), std::string::npos) << seen;
  const double low = std::atof(seen.c_str() + seen.find(" x ") + 3);
  EXPECT_LT(low, -20) << seen << ": not in millimetres";
  EXPECT_NE(stream::http(http_port, "/metrics").find("{protocol=\"openigtlink\",what=\"poses\"} 600"),
            std::string::npos);
  stop_and_replay();
}

INSTANTIATE_TEST_SUITE_P(, OpenIgtLinkPeer,
                         ::testing::Values(std::pair{"TRANSFORM", "1"}, std::pair{"QTDATA", "2"}));

TEST_F(NetworkInput, AnOpenIgtLinkServerThatWeConnectToCutsTheLiverInTwo) {
  Process tracker({"openigtlink_peer", "serve", "TDATA", "2", std::to_string(kPoses)});
  const std::string port = tracker.line("port ");
  ASSERT_FALSE(port.empty());
  start(R"("openigtlink": {"connect": ["127.0.0.1:)" + port.substr(5) +
        R"("], "ask_for": "TDATA", "silence_s": 3600})");
  ASSERT_EQ(tracker.line("sent", 120), "sent");
  ASSERT_TRUE(eventually([&] { return stats()["openigtlink"]["poses"] == kPoses; })) << stats();
  tracker.signal(SIGKILL);
  ASSERT_TRUE(settled(kPoses)) << stats();
  EXPECT_EQ(pieces(), 2u);
  EXPECT_TRUE(eventually([&] { return stats()["openigtlink"]["peers"][0]["connected"] == false; }));
  stop_and_replay();
}

#endif

TEST_F(NetworkInput, AHaplyInverse3CutsTheLiverInTwoAndIsFelt) {
  constexpr std::size_t kStates = 800;
  // The pass, with button a held; then it is let go. One step for each command that comes.
  tests::InverseService service([](std::size_t n, const std::string&) {
    const double way = std::min(1.0, static_cast<double>(n) / (kStates - 1));
    return tests::inverse_state(0.03, -0.1 + 0.2 * way, 0.07, n < kStates).dump();
  });
  start(R"("haply": {"url": ")" + service.url() + R"(", "max_force_n": 2.5})");
  ASSERT_TRUE(eventually([&] { return service.messages().size() > kStates + 50; })) << stats();
  EXPECT_EQ(stats()["haply"]["peers"][0]["sources"], json::array({"haply"}));
  ASSERT_TRUE(eventually([&] {
    const json s = stats();
    return s["poses"]["accepted"].get<std::size_t>() > kStates + 20 && s["backlog"]["batches"] == 0;
  })) << stats();
  EXPECT_EQ(stats()["strokes"], 1);
  EXPECT_EQ(pieces(), 2u);
  EXPECT_EQ(stats()["haply"]["bad_messages"], 0);
  stop_and_replay();
  double strongest = 0;
  std::size_t felt = 0;
  for (const std::string& message : service.messages()) {
    const auto force = tests::force_of(message);
    ASSERT_TRUE(force) << message;
    const double size = std::hypot((*force)[0], (*force)[1], (*force)[2]);
    strongest = std::max(strongest, size);
    felt += size > 0;
  }
  EXPECT_LE(strongest, 2.5 + 1e-9);
  // How often depends on the machine: a service that gets no processor for 20 ms gets no force.
  EXPECT_GT(felt, 0u);
  EXPECT_TRUE(
      eventually([&] { return *tests::force_of(service.messages().back()) == std::vector<double>(3); }));
}

// ------------------------------------------------------------------------------------------------ /healthz

std::uint64_t switches_of(const fs::path& task) {
  std::ifstream in(task / "status");
  std::string word;
  std::uint64_t count = 0;
  while (in >> word) {
    if (word == "voluntary_ctxt_switches:") in >> count;
  }
  return count;
}

TEST_F(NetworkInput, HealthzTellsOfALoopThatStands) {
  start(R"("haply": {"url": ""})");
  const auto healthy = [&] { return stream::http(http_port, "/healthz").find("HTTP/1.1 200") == 0; };
  EXPECT_TRUE(healthy());
  // The loop is the thread that wakes most often; it alone is stopped, as a debugger would.
  std::map<fs::path, std::uint64_t> before;
  const fs::path tasks = "/proc/" + std::to_string(server->pid()) + "/task";
  for (const auto& task : fs::directory_iterator(tasks)) before[task.path()] = switches_of(task.path());
  std::this_thread::sleep_for(std::chrono::seconds(2));
  fs::path loop;
  std::uint64_t most = 0;
  for (const auto& [task, count] : before) {
    if (switches_of(task) - count < most) continue;
    most = switches_of(task) - count;
    loop = task;
  }
  const pid_t thread = std::atoi(loop.filename().c_str());
  if (ptrace(PTRACE_SEIZE, thread, nullptr, nullptr) != 0)
    GTEST_SKIP() << "no tracing here: " << std::strerror(errno);
  ASSERT_EQ(ptrace(PTRACE_INTERRUPT, thread, nullptr, nullptr), 0);
  ASSERT_EQ(waitpid(thread, nullptr, __WALL), thread);
  EXPECT_TRUE(eventually([&] {
    const std::string answer = stream::http(http_port, "/healthz");
    return answer.find("HTTP/1.1 503") == 0 &&
           answer.find("the loop has not advanced for") != std::string::npos;
  }));
  ASSERT_EQ(ptrace(PTRACE_DETACH, thread, nullptr, nullptr), 0);
  EXPECT_TRUE(eventually(healthy));
  server->signal(SIGTERM);
  EXPECT_EQ(server->wait(), 0);
}

}  // namespace
}  // namespace incise::e2e
