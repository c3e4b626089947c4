// incised and incise with a haptic device that umockdev simulates: its reports cut, the reports sent to it are
// checked, and it is unplugged and plugged in again.

#include <gtest/gtest.h>
#include <time.h>

#include <csignal>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "client/client.hpp"
#include "tests/e2e/process.hpp"
#include "tests/input/hid/stylus.hpp"
#include "tests/stream/raw_peer.hpp"
#include "tests/support/run_program.hpp"

namespace incise::e2e {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using tests::bytes_of;
using tests::eventually;
using tests::MockDevice;
using tests::stylus_report;

std::int64_t now_ns() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

class HidDevice : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(directory); }
  ~HidDevice() override { fs::remove_all(directory); }

  void write(const std::string& name, const std::string& text) const {
    std::ofstream(directory / name) << text;
  }
  std::string file(const std::string& name) const { return (directory / name).string(); }

  // `more`: further members of the configuration.
  void start(const std::string& more = "") {
    // Wall time means nothing on a busy machine: no pause ends a stroke here.
    write("server.json", R"({"mesh": {"phantom": "liver", "target_tets": 20000},
      "blade": {"heel": [0, 0, 0], "tip": [0, 0, -0.12]},
      "cut": {"gap_limit_s": 3600, "speed_limit_m_s": 100},
      "listen": {"tcp_port": 0, "http_port": 0},
      "loop": {"realtime_priority": 0, "lock_memory": false},
      "capture": {"path": "run.capture"}, "log": {"level": "warning"})" +
                             more + "}");
    server = std::make_unique<Process>(std::vector<std::string>{"incised", "--config", file("server.json")});
    const std::string line = server->line("listening ", 120);
    tcp_port = port_after(line, "tcp=");
    http_port = port_after(line, "http=");
    ASSERT_NE(tcp_port, 0) << line;
  }
  json stats() const {
    const std::string answer = stream::http(http_port, "/stats");
    return json::parse(answer.substr(answer.find("\r\n\r\n") + 4));
  }
  // What the server says of the first device that it reads.
  json device() const {
    const json all = stats();
    for (const json& one : all["devices"]) {
      if (!one["sources"].empty()) return one;
    }
    return json::object();
  }

  // The pass through the liver of README's first cut, as a stylus at 1 kHz makes it: from y = -0.1 to 0.1 m in `count`
  // reports, the button held but in the last.
  void pass(MockDevice& stylus, int count, int first = 0, int last = -1) {
    const std::int64_t begin = now_ns();
    for (int i = first; i < (last < 0 ? count : last); ++i) {
      const timespec due{(begin + 1'000'000 * std::int64_t{i - first}) / 1'000'000'000,
                         (begin + 1'000'000 * std::int64_t{i - first}) % 1'000'000'000};
      clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, nullptr);
      const auto report = stylus_report(static_cast<std::uint16_t>(i),
                                        {0.03, -0.1 + 0.2 * i / (count - 1), 0.07}, i + 1 < count ? 1 : 0);
      // The system's queue is full where the server got no time for 64 ms: a real device would have lost a report.
      ASSERT_TRUE(eventually([&] { return stylus.report(bytes_of(report)); })) << i;
    }
  }
  // Once the loop has cut all that came.
  bool settled(std::uint64_t poses) const {
    return eventually([&] {
      const json s = stats();
      return s["poses"]["accepted"].get<std::uint64_t>() +
                     s["poses"]["accepted as a new stroke"].get<std::uint64_t>() >=
                 poses &&
             s["backlog"]["batches"] == 0 && s["backlog"]["poses"] == 0;
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
  void stop() {
    server->signal(SIGTERM);
    EXPECT_EQ(server->wait(), 0);
  }

  tests::MockHid machine;
  fs::path directory = fs::temp_directory_path() / ("incise_hid_" + std::to_string(::getpid()));
  std::unique_ptr<Process> server;
  std::uint16_t tcp_port = 0, http_port = 0;
};

TEST_F(HidDevice, AStylusAtOneKilohertzCutsTheLiverInTwo) {
  constexpr int kReports = 2000;
  const auto stylus = machine.plug(tests::stylus());
  start();
  ASSERT_TRUE(eventually([&] { return !device().empty(); }));
  pass(*stylus, kReports);
  ASSERT_TRUE(settled(kReports)) << stats();
  const json seen = device();
  EXPECT_EQ(seen["device"], "1209:0001:S1");
  EXPECT_EQ(seen["reports"]["count"], kReports);
  EXPECT_EQ(seen["reports"]["lost"], 0);
  EXPECT_EQ(seen["reports"]["bad_values"], 0);
  EXPECT_EQ(stats()["strokes"], 1);
  EXPECT_EQ(pieces(), 2u);
  // What the hand felt: never more than the device can make, not nothing, and at the end nothing.
  double strongest = 0;
  std::size_t felt = 0;
  for (const MockDevice::Sent& sent : stylus->outputs()) {
    incise_stylus_output output;
    ASSERT_EQ(sent.bytes.size(), sizeof output);
    std::memcpy(&output, sent.bytes.data(), sizeof output);
    const core::Vec3 force{1e-6 * output.force[0], 1e-6 * output.force[1], 1e-6 * output.force[2]};
    strongest = std::max(strongest, core::length(force));
    felt += core::length(force) > 0;
  }
  EXPECT_LE(strongest, 3.3 + 1e-5);
  EXPECT_GT(strongest, 0.01);
  EXPECT_GT(felt, 100u);
  EXPECT_EQ(device()["forces"]["failed"], 0);
  stop();
  tests::Bytes released(sizeof(incise_stylus_output), 0);
  released[0] = INCISE_STYLUS_OUTPUT;
  EXPECT_EQ(stylus->outputs().back().bytes, released);
  // A session with a device is recorded as any other.
  Process replay({"incise", "replay", file("run.capture"), "--verify"});
  EXPECT_EQ(replay.wait(120), 0);
}

TEST_F(HidDevice, PulledOutInAStrokeAndPutBackElsewhere) {
  constexpr int kReports = 1000;
  auto stylus = machine.plug(tests::stylus("S1", 0, 1));
  start();
  ASSERT_TRUE(eventually([&] { return !device().empty(); }));
  pass(*stylus, kReports, 0, 500);
  ASSERT_TRUE(settled(500));
  stylus.reset();
  ASSERT_TRUE(eventually([&] { return stats()["sources"] == 0; }));
  stylus = machine.plug(tests::stylus("S1", 3, 2));
  ASSERT_TRUE(eventually([&] { return device().value("path", "") == "/dev/hidraw3"; }));
  EXPECT_EQ(device()["connections"], 2);
  EXPECT_EQ(device()["sources"], json::array({"incise_stylus"}));
  pass(*stylus, kReports);
  ASSERT_TRUE(settled(500 + kReports));
  EXPECT_EQ(stats()["strokes"], 2);
  EXPECT_EQ(pieces(), 2u);
  stop();
}

// ------------------------------------------------------------------------------------------------ incise devices

TEST_F(HidDevice, DevicesListsWhatIsThereAndWhichProfileFits) {
  const auto stylus = machine.plug(tests::stylus("S1", 0, 1));
  MockDevice::Kind foreign = tests::stylus("", 1, 2);
  foreign.vendor = 0x1532;
  foreign.product = 0x0300;
  foreign.descriptor = tests::from_hex("06 00 ff 09 01 a1 01 15 00 26 ff 00 75 08 95 5a 09 01 81 02 c0");
  const auto other = machine.plug(foreign);
  const auto result = tests::run_program("incise", {"devices"}, directory);
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.out.find("1209:0001:S1  Stylus"), std::string::npos) << result.out;
  EXPECT_NE(result.out.find("profile incise_stylus ("), std::string::npos) << result.out;
  EXPECT_NE(result.out.find("input 1: 40 bytes, output 2: 16 bytes, feature 3: 4 bytes"), std::string::npos)
      << result.out;
  const json all = json::parse(tests::run_program("incise", {"devices", "--json"}, directory).out);
  ASSERT_EQ(all.size(), 2u);
  EXPECT_EQ(all[0]["profile"], "incise_stylus");
  EXPECT_EQ(all[1]["profile"], "razer_hydra");
}

TEST_F(HidDevice, MonitorShowsLiveAxesOfAProfileOfOnesOwn) {
  fs::create_directories(directory / "profiles");
  write("profiles/knob.json", R"({"name": "Knob", "vendor": "abcd", "product": "0007", "report": 9,
    "start": [{"feature": "0a 01"}], "stop": [{"feature": "0a 00"}], "tools": [
    {"position": {"x": {"at": 1, "type": "i16be", "scale": 0.0001}}, "buttons": [{"at": 3, "bit": 7, "type": "u1"}]}]})");
  write("own.json", R"({"devices": {"profiles": "profiles"}})");
  MockDevice::Kind kind{0xabcd,
                        7,
                        "Knob",
                        "",
                        tests::from_hex("06 00 ff 09 01 a1 01 85 09 15 00 26 ff 00 75 08 95 03 "
                                        "09 01 81 02 85 0a 95 01 09 01 b1 02 c0"),
                        0,
                        0,
                        1};
  const auto knob = machine.plug(kind);
  Process monitor({"incise", "devices", "--monitor", "--config", file("own.json"), "--json", "--for", "60"});
  ASSERT_FALSE(monitor.line("{", 60).empty());  // it is open
  ASSERT_TRUE(knob->report(tests::from_hex("09 fe 0c 80")));
  json line;
  ASSERT_TRUE(eventually([&] {
    line = json::parse(monitor.line("{", 60));
    return line.contains("tools");
  }));
  EXPECT_NEAR(line["tools"][0]["position"][0].get<double>(), -0.05, 1e-12);
  EXPECT_EQ(line["tools"][0]["buttons"], 1);
  EXPECT_EQ(line["tools"][0]["source"], "knob");
  EXPECT_EQ(line["reports"]["9"], "09 fe 0c 80");
  ASSERT_EQ(knob->features().size(), 1u);
  EXPECT_EQ(knob->features()[0].bytes, tests::from_hex("0a 01"));
  monitor.signal(SIGINT);
  EXPECT_EQ(monitor.wait(), 0);
  ASSERT_EQ(knob->features().size(), 2u) << "started, and not stopped";
  EXPECT_EQ(knob->features()[1].bytes, tests::from_hex("0a 00"));
}

TEST_F(HidDevice, CheckSaysWhatIsWrongWithAProfile) {
  write(
      "bad.json",
      R"({"name": "Bad", "vendor": "1", "product": "2", "tools": [{"position": {"x": {"at": 1, "type": "i99"}}}]})");
  const auto bad = tests::run_program("incise", {"devices", "--check", "bad.json"}, directory);
  EXPECT_EQ(bad.exit_code, 1);
  EXPECT_NE(bad.err.find("bad.json: tools[0].position.x.type: found \"i99\"; accepted is"), std::string::npos)
      << bad.err;
  const auto good = tests::run_program(
      "incise", {"devices", "--check", std::string(INCISE_SOURCE_DIR) + "/config/devices/razer_hydra.json"},
      directory);
  EXPECT_EQ(good.exit_code, 0) << good.err;
  // A server with a wrong profile does not start, and says the same.
  fs::create_directories(directory / "profiles");
  fs::copy(directory / "bad.json", directory / "profiles/bad.json");
  write("own.json", R"({"mesh": {"phantom": "slab"}, "devices": {"profiles": "profiles"}})");
  const auto checked = tests::run_program("incised", {"--check", "own.json"}, directory);
  EXPECT_EQ(checked.exit_code, 1);
  EXPECT_NE(checked.err.find("bad.json: tools[0].position.x.type"), std::string::npos) << checked.err;
}

}  // namespace
}  // namespace incise::e2e
