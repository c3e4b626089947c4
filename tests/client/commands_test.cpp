#include "client/cli/commands.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>
#include <thread>
#include <vector>

#include "client/cli/usage.hpp"
#include "protocol/capture.hpp"
#include "protocol/motion.hpp"
#include "server/app/offline/streamed_motion.hpp"
#include "server/base/clock.hpp"
#include "tests/client/recorded_session.hpp"
#include "tests/stream/mini_loop.hpp"

namespace incise::client {
namespace {

namespace fs = std::filesystem;
using stream::TestServer;

// As the program plays it.
int stream(const StreamCommand& command) {
  return run_stream(command, app::read_streamed_motion(command));
}

TEST(ParseAddress, TakesTransportHostAndPort) {
  const auto check = [](const std::string& text, const std::string& host, int port, TransportKind kind,
                        bool tls) {
    const Address a = parse_address(text);
    EXPECT_EQ(a.host, host) << text;
    EXPECT_EQ(a.port, port) << text;
    EXPECT_EQ(a.transport, kind) << text;
    EXPECT_EQ(a.tls, tls) << text;
  };
  check("localhost:7450", "localhost", 7450, TransportKind::kTcp, false);
  check("tcp://127.0.0.1:1", "127.0.0.1", 1, TransportKind::kTcp, false);
  check("tls://a.example:65535", "a.example", 65535, TransportKind::kTcp, true);
  check("ws://[::1]:80", "::1", 80, TransportKind::kWebSocket, false);
  check("wss://b:443", "b", 443, TransportKind::kWebSocket, true);
  check("localhost", "localhost", 7450, TransportKind::kTcp, false);
  check("tls://a.example", "a.example", 7450, TransportKind::kTcp, true);
  check("[::1]", "::1", 7450, TransportKind::kTcp, false);
  check("ws://[::1]", "::1", 7480, TransportKind::kWebSocket, false);
}

TEST(ParseAddress, NamesWhatItCannotUse) {
  for (const char* text :
       {"", "tcp://", "::1", ":7450", "host:", "host:0", "host:65536", "host:12x", "host:-1", "::1:80",
        "http://host:80", "ws://host:80/ws", "user@host:80", "[]:80"}) {
    try {
      parse_address(text);
      ADD_FAILURE() << text;
    } catch (const std::invalid_argument& error) {
      EXPECT_NE(std::string(error.what()).find('"' + std::string(text) + '"'), std::string::npos);
    }
  }
}

class CommandsTest : public ::testing::Test {
 protected:
  CommandsTest() {
    fs::create_directories(directory);
    std::ofstream csv(directory / "motion.csv");
    csv << "t_s,x_m,y_m,z_m,qw,qx,qy,qz,button\n";
    for (const auto& p : stream::sweep(0.03, 200, 1'000'000, 0.06)) {
      csv << static_cast<double>(p.source_ns) * 1e-9 << ',' << p.position.x << ',' << p.position.y << ','
          << p.position.z << ",1,0,0,0," << p.buttons << '\n';
    }
    test.loop.start();
  }
  ~CommandsTest() override { fs::remove_all(directory); }
  std::string address() const { return "127.0.0.1:" + std::to_string(test.server.tcp_port()); }

  // What an incised says once a second.
  stream::Providers providers() {
    stream::Providers out;
    out.statistics = [this] {
      protocol::Stats stats;
      stats.live_tets = test.loop.live_tets();
      return stats;
    };
    return out;
  }

  StreamCommand stream_of(const char* file, double speed) const {
    StreamCommand command;
    command.poses = directory / file;
    command.server.address = address();
    command.speed = speed;
    command.json = true;
    return command;
  }

  fs::path directory = fs::temp_directory_path() / ("incise_commands_" + std::to_string(::getpid()));
  TestServer test{6, stream::test_config(), providers()};
};

TEST_F(CommandsTest, StreamPlaysAMotionAndSumsUp) {
  StreamCommand command = stream_of("motion.csv", 4);
  ::testing::internal::CaptureStdout();
  EXPECT_EQ(stream(command), 0);
  const auto summary = nlohmann::json::parse(::testing::internal::GetCapturedStdout());
  EXPECT_EQ(summary["poses_sent"], 200);
  EXPECT_EQ(summary["accepted"], 200);
  EXPECT_EQ(summary["settled"], true);
  EXPECT_EQ(summary["first_revision"], 0);
  EXPECT_EQ(summary["revision"], test.loop.revision());
  EXPECT_GT(test.loop.revision(), 3u);
}

// Poses that the server takes and cannot record are no failure of the player's, but it says so.
TEST_F(CommandsTest, StreamWarnsWhereItsPosesAreNotRecorded) {
  stream::Providers providers;
  providers.recording = [] {
    return stream::RecordingNow{protocol::Recording::Stopped, "disk.capture: No space left on device"};
  };
  TestServer full(6, stream::test_config(), std::move(providers));
  full.loop.start();
  StreamCommand command;
  command.poses = directory / "motion.csv";
  command.speed = 0;
  command.json = true;
  const auto run = [&](const TestServer& server, std::string& told) {
    command.server.address = "127.0.0.1:" + std::to_string(server.server.tcp_port());
    ::testing::internal::CaptureStdout();
    ::testing::internal::CaptureStderr();
    EXPECT_EQ(stream(command), 0);
    told = ::testing::internal::GetCapturedStderr();
    return nlohmann::json::parse(::testing::internal::GetCapturedStdout());
  };
  std::string told;
  auto summary = run(full, told);
  EXPECT_EQ(summary["recording"], "stopped");
  EXPECT_EQ(summary["accepted"], 200);
  EXPECT_EQ(summary["recorded"], 0);
  EXPECT_NE(
      told.find("incise: server: poses are cut, but not recorded: disk.capture: No space left on device"),
      std::string::npos)
      << told;
  EXPECT_NE(told.find("200 of 200 accepted poses are not in the server's capture"), std::string::npos)
      << told;
  // A server that keeps no capture does not promise one.
  summary = run(test, told);
  EXPECT_EQ(summary["recording"], "off");
  EXPECT_EQ(told, "");
}

TEST_F(CommandsTest, WatchersOfBothTransportsSaveTheSameBytes) {
  StreamCommand play;
  play.poses = directory / "motion.csv";
  play.server.address = address();
  play.speed = 0;
  ::testing::internal::CaptureStdout();
  EXPECT_EQ(stream(play), 0);
  ::testing::internal::GetCapturedStdout();
  for (const char* name : {"tcp", "ws"}) {
    WatchCommand watch;
    watch.server.address =
        name == std::string("tcp") ? address() : "ws://127.0.0.1:" + std::to_string(test.server.http_port());
    watch.until_revision = test.loop.revision();
    watch.for_s = 20;
    watch.save = directory / name;
    watch.json = true;
    ::testing::internal::CaptureStdout();
    const auto began = std::chrono::steady_clock::now();
    EXPECT_EQ(run_watch(watch), 0);
    const bool at_once = std::chrono::steady_clock::now() - began < std::chrono::milliseconds(500);
    std::istringstream lines(::testing::internal::GetCapturedStdout());
    nlohmann::json line;  // the last one
    for (std::string text; std::getline(lines, text);) line = nlohmann::json::parse(text);
    EXPECT_EQ(line["revision"], test.loop.revision());
    EXPECT_GT(line["cut_area_m2"], 0) << "also where it ends as soon as the snapshot is there";
    if (at_once) {
      EXPECT_TRUE(line["bytes_per_s"].is_null()) << line;
    }
  }
  const auto bytes = [&](const char* name) {
    std::ifstream in(directory / name, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(in), {});
  };
  EXPECT_GT(bytes("tcp").size(), 1000u);
  EXPECT_EQ(bytes("tcp"), bytes("ws"));
}

TEST_F(CommandsTest, AWatcherOfTheSurfaceSeesTheBodyAsOneOfTheVolumeDoes) {
  StreamCommand play;
  play.poses = directory / "motion.csv";
  play.server.address = address();
  play.speed = 0;
  ::testing::internal::CaptureStdout();
  EXPECT_EQ(stream(play), 0);
  ::testing::internal::GetCapturedStdout();
  // The last line of a watcher that stays until it has seen both what was cut before it came and the statistics.
  const auto last_line = [&](const char* view) {
    nlohmann::json last;
    for (double for_s = 1.1; for_s < 60; for_s *= 2) {
      WatchCommand watch;
      watch.server.address = address();
      watch.view = view;
      watch.for_s = for_s;
      watch.json = true;
      ::testing::internal::CaptureStdout();
      EXPECT_EQ(run_watch(watch), 0);
      std::istringstream lines(::testing::internal::GetCapturedStdout());
      for (std::string line; std::getline(lines, line);) last = nlohmann::json::parse(line);
      EXPECT_NE(last["tets"], 0);
      if (!last["tets"].is_null() && last["cut_area_m2"] > 0) break;
    }
    return last;
  };
  const nlohmann::json volume = last_line("volume"), surface = last_line("surface");
  EXPECT_GT(volume["cut_area_m2"], 1e-3);
  EXPECT_NEAR(surface["cut_area_m2"].get<double>(), volume["cut_area_m2"].get<double>(), 1e-6);
  EXPECT_EQ(surface["tets"], volume["tets"]);
  EXPECT_EQ(surface["pieces"], volume["pieces"]);
}

TEST_F(CommandsTest, StreamSkipsSamplesWhoseTimeDoesNotRiseAndSaysThatNothingWasCut) {
  std::ofstream(directory / "twice.csv")
      << "t_s,x_m,y_m,z_m,button\n0,9,0,0,1\n0.01,9,0,0.01,1\n0.01,9,0,0.02,1\n"
         "0.02,9,0,0.03,1\n";
  StreamCommand command;
  command.poses = directory / "twice.csv";
  command.server.address = address();
  command.json = true;
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  EXPECT_EQ(stream(command), 0);
  EXPECT_EQ(nlohmann::json::parse(::testing::internal::GetCapturedStdout())["accepted"], 3);
  const std::string told = ::testing::internal::GetCapturedStderr();
  EXPECT_NE(told.find("warning: " + command.poses.string() + ": skipped 1 of 4 samples"), std::string::npos)
      << told;
  EXPECT_NE(told.find("warning: nothing was cut"), std::string::npos) << told;
  command.strict = true;
  EXPECT_THROW(stream(command), protocol::MotionError);
}

// As where README's motion of two poses is played, which `incise cut` takes as it is: the limits with their values, and what the motion has.
TEST_F(CommandsTest, StreamSaysWhichLimitsMadeJumpsOfItsSteps) {
  std::ofstream(directory / "pass.tum") << "0 0.03 -0.1 0.07 0 0 0 1\n1 0.03 0.1 0.07 0 0 0 1\n";
  StreamCommand command;
  command.poses = directory / "pass.tum";
  command.server.address = address();
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  EXPECT_EQ(stream(command), 0);
  ::testing::internal::GetCapturedStdout();
  const std::string told = ::testing::internal::GetCapturedStderr();
  EXPECT_NE(
      told.find("warning: nothing was cut by blade \"blade\": 1 step was treated as a jump, which is faster "
                "than the server's cut.speed_limit_m_s (2 m/s) or comes after more than its cut.gap_limit_s "
                "(0.25 s by default): the poses are up to 1 s apart; "),
      std::string::npos)
      << told;
}

// A capture of what `append` gives to its writer.
template <class Append>
void write_capture(const fs::path& path, Append append) {
  protocol::FileSink sink(path.string(), true);
  protocol::CaptureHeader header;
  header.config_json = "{}";
  protocol::CaptureWriter writer(sink, header);
  append(writer);
  ASSERT_FALSE(writer.flush());
}

// The same motion played twice in one session: the capture's clock goes back in between. The second source has a clock of its own.
TEST_F(CommandsTest, StreamPlaysTheWholeOfACaptureWhoseClockRestarts) {
  StreamCommand command = stream_of("two.capture", 0);
  write_capture(command.poses, [](protocol::CaptureWriter& writer) {
    const auto motion = stream::sweep(0.03, 2000, 1'000'000, 0.06);  // 2 s
    for (int round = 0; round < 2; ++round) {
      for (const auto& pose : motion) writer.append(protocol::PoseRecord{0, pose, 0});
    }
    for (int i = 0; i < 3; ++i) {
      protocol::PoseSample pose = motion.front();
      pose.source_ns += 1'000'000 * i;
      writer.append(protocol::PoseRecord{2, pose, 0});
    }
  });
  std::string told;
  const auto run = [&] {
    ::testing::internal::CaptureStdout();
    ::testing::internal::CaptureStderr();
    EXPECT_EQ(stream(command), 0);
    told = ::testing::internal::GetCapturedStderr();
    return nlohmann::json::parse(::testing::internal::GetCapturedStdout());
  };
  const std::string name = "warning: " + command.poses.string() + ": ";
  EXPECT_EQ(run()["accepted"], 4000);
  EXPECT_NE(told.find(name + "the clock restarts once (time "), std::string::npos) << told;
  EXPECT_EQ(told.find("skipped"), std::string::npos) << told;
  EXPECT_NE(told.find(name + "sends the poses of source 0, not those of source 2 (3 poses); --from-source N "
                             "sends those of source N\n"),
            std::string::npos)
      << told;
  command.from_source = 2;
  EXPECT_EQ(run()["poses_sent"], 3);
  EXPECT_EQ(told.find(name), std::string::npos) << told;
  command.from_source = 1;
  try {
    stream(command);
    ADD_FAILURE() << "there is no such source";
  } catch (const std::runtime_error& error) {
    EXPECT_EQ(std::string(error.what()), "--from-source: found 1; " + command.poses.string() +
                                             " has poses of source 0 (4000 poses), source 2 (3 poses)");
  }
  command.from_source = 0;
  command.strict = true;
  EXPECT_THROW(stream(command), protocol::MotionError);
  command.poses = directory / "motion.csv";
  EXPECT_THROW(stream(command), UsageError);
}

// Three operators take a blade one after the other, each with a clock from 0 and a stroke of less than a second.
TEST_F(CommandsTest, StreamPlaysWhatEachHolderOfABladeDid) {
  StreamCommand command = stream_of("three.capture", 0);
  write_capture(command.poses, [](protocol::CaptureWriter& writer) {
    for (int holder = 0; holder < 3; ++holder) {
      writer.append(protocol::StrokeRecord{0, protocol::StrokeAction::HandOver, 0, 0});
      for (const auto& pose : stream::sweep(0.03, 150, 1'000'000, 0.06))
        writer.append(protocol::PoseRecord{0, pose, 0});
    }
  });
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  command.strict = true;
  EXPECT_EQ(stream(command), 0);
  EXPECT_EQ(::testing::internal::GetCapturedStderr().find("warning"), std::string::npos);
  const auto told = nlohmann::json::parse(::testing::internal::GetCapturedStdout());
  EXPECT_EQ(told["accepted"], 450);
}

// What was undone and what was before a reset is no more, as in a replay: the counts of --from-source are without it, too.
TEST_F(CommandsTest, StreamPlaysOnlyWhatCountsOfACapture) {
  StreamCommand command = stream_of("undone.capture", 0);
  write_capture(command.poses, [](protocol::CaptureWriter& writer) {
    const auto stroke = [&](std::uint32_t source, std::int64_t from_ns, int poses) {
      protocol::PoseSample pose;
      for (int i = 0; i < poses; ++i) {
        pose.source_ns = from_ns + 1'000'000 * i;
        writer.append(protocol::PoseRecord{source, pose, pose.source_ns + 5});
      }
    };
    stroke(0, 0, 1000);
    writer.append(protocol::ResetRecord{2, 0});
    stroke(0, 10'000'000'000, 100);
    stroke(0, 11'000'000'000, 30);
    writer.append(protocol::UndoRecord{3, 0, 0, 11'000'000'000, 11'000'000'005, 0});
    stroke(1, 12'000'000'000, 7);
    stroke(0, 12'500'000'000, 50);
  });
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  EXPECT_EQ(stream(command), 0);
  const std::string told = ::testing::internal::GetCapturedStderr();
  const auto summary = nlohmann::json::parse(::testing::internal::GetCapturedStdout());
  EXPECT_EQ(summary["poses_sent"], 150);
  EXPECT_NE(told.find("a stroke was undone; the others are used"), std::string::npos) << told;
  EXPECT_NE(told.find("what came after the last reset is used"), std::string::npos) << told;
  command.from_source = 2;
  try {
    stream(command);
    ADD_FAILURE() << "there is no such source";
  } catch (const std::runtime_error& error) {
    EXPECT_EQ(std::string(error.what()), "--from-source: found 2; " + command.poses.string() +
                                             " has poses of source 0 (150 poses), source 1 (7 poses)");
  }
}

TEST_F(CommandsTest, AWatcherWhoseServerHasGoneSaysSoAndEnds) {
  WatchCommand watch;
  watch.server.address = address();
  watch.give_up_after_s = 0.3;
  watch.save = directory / "last";
  const std::jthread stopping([&] {
    stream::eventually([&] { return test.server.counters().snapshots > 0; });
    test.server.stop();
  });
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  EXPECT_EQ(run_watch(watch), 1);
  ::testing::internal::GetCapturedStdout();
  const std::string told = ::testing::internal::GetCapturedStderr();
  EXPECT_NE(told.find("is gone; trying to connect again for 0.3 s"), std::string::npos) << told;
  EXPECT_NE(told.find("did not come back within 0.3 s: "), std::string::npos) << told;
  EXPECT_NE(told.find("Connection refused"), std::string::npos) << told;
  EXPECT_TRUE(fs::exists(directory / "last")) << "what was held is saved all the same";
}

TEST_F(CommandsTest, ATokenEndsWhereItsLineDoes) {
  ServerOptions options;
  options.address = address();
  options.token_file = directory / "token";
  Address where;
  for (const char* line : {"a-token", "a-token\n", "a-token\r\n", "a-token \t\r\nmore"}) {
    std::ofstream(options.token_file) << line;
    EXPECT_EQ(options.options(where).token, "a-token");
  }
  for (const char* line : {"", "\n", "\r\na-token"}) {
    std::ofstream(options.token_file) << line;
    EXPECT_THROW(options.options(where), std::runtime_error);
  }
}

// A watcher of a server that does what a test says, and the lines that it prints.
struct Watched {
  explicit Watched(const std::function<void(const stream::Listener&)>& server) {
    const stream::Listener listener;
    const std::jthread thread([&] { server(listener); });
    WatchCommand watch;
    watch.server.address = "127.0.0.1:" + std::to_string(listener.port());
    watch.until_revision = recording().steps.size();
    watch.for_s = 20;
    watch.give_up_after_s = 20;
    watch.json = true;
    ::testing::internal::CaptureStdout();
    ::testing::internal::CaptureStderr();
    status = run_watch(watch);
    std::istringstream text(::testing::internal::GetCapturedStdout());
    for (std::string line; std::getline(text, line);) lines.push_back(nlohmann::json::parse(line));
    told = ::testing::internal::GetCapturedStderr();
  }
  static const Recording& recording() {
    static const Recording made;
    return made;
  }
  int status = -1;
  std::vector<nlohmann::json> lines;
  std::string told;
};
TEST(Watch, TimesAreInMillisecondsAndPercentilesOfWhatCame) {
  ASSERT_GT(Watched::recording().steps.size(), 4u);
  const Watched watched([](const stream::Listener& listener) {
    const auto peer = listener.accept();
    if (!peer->receive_until<protocol::Hello>()) return;
    play(*peer, Watched::recording().welcome);
    play(*peer, Watched::recording().snapshot);
    std::int64_t ms = 0;
    for (const auto& step : Watched::recording().steps) {
      auto delta = std::get<protocol::Delta>(step.message.body);
      delta.steps[0].cut_ns = delta.steps[0].arrival_ns + ++ms * 1'000'000;
      peer->send(delta);
    }
    peer->receive_until<protocol::Bye>();
  });
  EXPECT_EQ(watched.status, 0) << watched.told;
  double p50 = 0, p99 = 0;
  for (const auto& line : watched.lines) {
    if (line["pose_to_cut_ms"]["p50"].is_null()) continue;
    p50 = std::max(p50, line["pose_to_cut_ms"]["p50"].get<double>());
    p99 = std::max(p99, line["pose_to_cut_ms"]["p99"].get<double>());
  }
  // The watcher ends when it has seen the last step, which may not be counted yet.
  const auto steps = static_cast<double>(Watched::recording().steps.size());
  EXPECT_LT(p99, steps + 0.5);
  EXPECT_GT(p99, steps - 1.5);
  EXPECT_GT(p50, 1.5);
}

TEST(Watch, TimesOfNothingAreNull) {
  const Watched watched([](const stream::Listener& listener) {
    const auto peer = listener.accept();
    if (!peer->receive_until<protocol::Hello>()) return;
    play(*peer, Watched::recording().welcome);
    play(*peer, Watched::recording().snapshot);
    // Longer than until the first line.
    std::this_thread::sleep_for(std::chrono::milliseconds(1500));
    for (const auto& step : Watched::recording().steps)
      peer->send(std::get<protocol::Delta>(step.message.body));
    peer->receive_until<protocol::Bye>();
  });
  ASSERT_GE(watched.lines.size(), 2u) << watched.told;
  for (const char* time : {"pose_to_cut_ms", "cut_to_here_ms", "pose_to_here_ms"}) {
    for (const char* percentile : {"p50", "p99"})
      EXPECT_TRUE(watched.lines[0][time][percentile].is_null()) << watched.lines[0];
  }
}

// Not only at the end of hours.
TEST(Watch, APlaceWhereNothingCanBeSavedIsRefusedAtOnce) {
  const fs::path directory = fs::temp_directory_path() / ("incise_watch_save_" + std::to_string(::getpid()));
  fs::create_directory(directory);
  WatchCommand watch;
  watch.server.address = "127.0.0.1:1";  // nobody listens there
  const auto error_of = [&](const fs::path& save) {
    watch.save = save;
    try {
      run_watch(watch);
    } catch (const std::runtime_error& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  const std::string parent = (directory / "no").string();
  EXPECT_EQ(error_of(directory / "no" / "w.bin"), "--save " + parent + "/w.bin: the directory " + parent +
                                                      " does not exist; make it first (mkdir -p " + parent +
                                                      ")");
  EXPECT_EQ(error_of(directory),
            "--save " + directory.string() + ": is a directory; accepted is a file's name");
  fs::remove_all(directory);
}

// As where the server's clock is estimated a little too far behind.
TEST(Watch, NothingComesBeforeItWasCut) {
  const Watched watched([](const stream::Listener& listener) {
    const auto peer = listener.accept();
    if (!peer->receive_until<protocol::Hello>()) return;
    play(*peer, Watched::recording().welcome);
    play(*peer, Watched::recording().snapshot);
    for (const auto& step : Watched::recording().steps) {
      auto delta = std::get<protocol::Delta>(step.message.body);
      delta.steps[0].cut_ns = monotonic_ns() + 3'600'000'000'000;
      delta.steps[0].arrival_ns = delta.steps[0].cut_ns - 2'000'000;
      peer->send(delta);
    }
    peer->receive_until<protocol::Bye>();
  });
  EXPECT_EQ(watched.status, 0) << watched.told;
  double most_ms = 0;
  for (const auto& line : watched.lines) {
    if (line["cut_to_here_ms"]["p50"].is_null()) continue;
    EXPECT_GE(line["cut_to_here_ms"]["p50"].get<double>(), 0);
    EXPECT_GE(line["pose_to_here_ms"]["p50"].get<double>(), 0);
    most_ms = std::max(most_ms, line["pose_to_here_ms"]["p99"].get<double>());
  }
  EXPECT_NEAR(most_ms, 2, 1e-3);
}

TEST(Watch, AServerThatComesBackIsSaidToOnce) {
  const Watched watched([](const stream::Listener& listener) {
    {
      const auto peer = listener.accept();
      if (!peer->receive_until<protocol::Hello>()) return;
      play(*peer, Watched::recording().welcome);
      peer->receive_until<protocol::Ping>();
    }
    const auto peer = listener.accept();
    if (!peer->receive_until<protocol::Hello>()) return;
    play(*peer, Watched::recording().welcome);
    peer->receive_until<protocol::Ping>();
    std::this_thread::sleep_for(std::chrono::milliseconds(300));  // some looks of the watcher's
    play(*peer, Watched::recording().snapshot);
    play(*peer, Watched::recording().steps);
    peer->receive_until<protocol::Bye>();
  });
  EXPECT_EQ(watched.status, 0) << watched.told;
  const std::string text = "incise: connected again\n";
  const std::size_t first = watched.told.find(text);
  ASSERT_NE(first, std::string::npos) << watched.told;
  EXPECT_EQ(watched.told.find(text, first + 1), std::string::npos) << watched.told;
}

TEST_F(CommandsTest, OfACaptureTheFirstSourceIsPlayed) {
  const fs::path capture = directory / "two.capture";
  write_capture(capture, [](protocol::CaptureWriter& writer) {
    for (std::uint32_t i = 0; i < 30; ++i) {
      protocol::PoseRecord record;
      record.source = i % 3 == 0 ? 4 : 5;
      record.pose.source_ns = (i + 1) * std::int64_t{1'000'000};
      writer.append(record);
    }
  });
  StreamCommand command;
  command.poses = capture;
  command.server.address = address();
  command.speed = 0;
  command.json = true;
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  EXPECT_EQ(stream(command), 0);
  ::testing::internal::GetCapturedStderr();
  const auto summary = nlohmann::json::parse(::testing::internal::GetCapturedStdout());
  EXPECT_EQ(summary["poses_sent"], 10);
  EXPECT_EQ(summary["accepted"], 10);
}

TEST_F(CommandsTest, AtATenthOfTheSpeedItTakesTenTimesAsLong) {
  StreamCommand command = stream_of("motion.csv", 0.1);  // of 0.2 s
  ::testing::internal::CaptureStdout();
  EXPECT_EQ(stream(command), 0);
  EXPECT_GE(nlohmann::json::parse(::testing::internal::GetCapturedStdout())["seconds"], 1.99);
}

// A server that welcomes a player, and what the player sends it.
struct PlayedTo {
  // Poses, until there are `count`; none where the player ends first.
  static std::vector<protocol::PoseSample> poses(stream::RawPeer& peer, std::size_t count) {
    std::vector<protocol::PoseSample> all;
    while (all.size() < count) {
      const auto received = peer.receive_until<protocol::PoseBatch>();
      if (!received) return {};
      const auto& batch = std::get<protocol::PoseBatch>(received->message.body);
      all.insert(all.end(), batch.poses.begin(), batch.poses.end());
      sequence = received->message.envelope.sequence;
    }
    return all;
  }
  PlayedTo(const std::function<void(stream::RawPeer&)>& server, StreamCommand command) {
    const stream::Listener listener;
    std::thread thread([&] {
      const auto peer = listener.accept();
      if (!peer->receive_until<protocol::Hello>()) return;
      peer->send(protocol::Welcome{});
      server(*peer);
    });
    command.server.address = "127.0.0.1:" + std::to_string(listener.port());
    ::testing::internal::CaptureStdout();
    ::testing::internal::CaptureStderr();
    try {
      status = stream(command);
    } catch (const std::runtime_error& error) {
      thrown = error.what();  // it has gone
    }
    thread.join();
    printed = ::testing::internal::GetCapturedStdout();
    ::testing::internal::GetCapturedStderr();
  }
  static inline std::uint64_t sequence = 0;  // of the last batch
  int status = -1;
  std::string printed, thrown;
};

// Between two rounds lies half a second of source time, at any speed: the server begins a new stroke there.
TEST_F(CommandsTest, InALoopEachRoundBeginsHalfASecondAfterTheLast) {
  StreamCommand command;
  command.poses = directory / "motion.csv";
  command.speed = 0;
  command.loop = true;
  command.json = true;
  std::vector<protocol::PoseSample> poses;
  const PlayedTo played([&](stream::RawPeer& peer) { poses = PlayedTo::poses(peer, 600); }, command);
  ASSERT_GE(poses.size(), 600u);
  for (std::size_t i = 1; i < poses.size(); ++i) {
    EXPECT_EQ(poses[i].source_ns - poses[i - 1].source_ns, i % 200 == 0 ? 500'000'000 : 1'000'000) << i;
    EXPECT_EQ(poses[i].position, poses[i % 200].position) << i;
  }
  EXPECT_GE(nlohmann::json::parse(played.printed)["rounds"], 3);
}

TEST_F(CommandsTest, EveryPoseThatTheServerRejectsIsCounted) {
  StreamCommand command;
  command.poses = directory / "motion.csv";
  command.speed = 0;
  const auto server = [](stream::RawPeer& peer) {
    PlayedTo::poses(peer, 200);
    protocol::PoseReport report;
    report.through_sequence = PlayedTo::sequence;
    report.accepted = 98765;
    report.not_finite = 1;
    report.not_unit = 20;
    report.time_not_rising = 300;
    report.queue_full = 4000;
    report.too_fast = 7;
    peer.send(report);
    peer.receive_until<protocol::Bye>();
  };
  const PlayedTo text(server, command);
  EXPECT_EQ(text.status, 0);
  EXPECT_NE(text.printed.find(": 98765 accepted, 4321 rejected (1 not finite or more than 10 km away, 20 "
                              "without a unit quaternion, 300 with a "
                              "time that does not rise, 4000 queue full); 7 new strokes"),
            std::string::npos)
      << text.printed;
  command.json = true;
  const auto summary = nlohmann::json::parse(PlayedTo(server, command).printed);
  EXPECT_EQ(summary["accepted"], 98765);
  EXPECT_EQ(
      summary["rejected"],
      (nlohmann::json{{"not_finite", 1}, {"not_unit", 20}, {"time_not_rising", 300}, {"queue_full", 4000}}));
}

TEST_F(CommandsTest, AServerThatDiesIsNamedWithWhatItAcknowledged) {
  StreamCommand command;
  command.poses = directory / "motion.csv";
  command.speed = 0;
  const PlayedTo played(
      [](stream::RawPeer& peer) {
        PlayedTo::poses(peer, 200);
        protocol::PoseReport report;
        report.through_sequence = PlayedTo::sequence - 1;
        report.accepted = 120;
        report.not_unit = 3;
        report.too_fast = 1;
        peer.send(report);
      },
      command);
  EXPECT_EQ(played.status, -1);
  EXPECT_NE(played.thrown.find("; it acknowledged 123 of 200 poses sent"), std::string::npos)
      << played.thrown;
  EXPECT_NE(played.printed.find("; 1 new stroke by speed or gap\n"), std::string::npos) << played.printed;
  EXPECT_EQ(played.printed.find("within 10 s"), std::string::npos) << played.printed;
}

TEST_F(CommandsTest, ABladeThatIsHeldComesWithWhatToDo) {
  const StreamCommand command = stream_of("motion.csv", 0);
  Options options;
  options.role = protocol::Role::Operator;
  options.source_name = command.source_name;
  const auto holder = Client::connect("127.0.0.1", test.server.tcp_port(), options);
  try {
    stream(command);
    ADD_FAILURE() << "two hold a blade";
  } catch (const ConnectError& error) {
    EXPECT_NE(std::string(error.what()).find("; --source NAME uses another blade, --take-over takes it"),
              std::string::npos)
        << error.what();
  }
}

TEST_F(CommandsTest, AMissingTokenComesWithWhereToGiveOne) {
  stream::StreamConfig config = stream::test_config();
  config.tokens = {{"sixteen letters or more", {protocol::Role::Viewer}}};
  TestServer guarded(2, config);
  const auto problem = [&](const std::string& token) {
    Options options;
    options.token = token;
    try {
      connect({.host = "127.0.0.1", .port = guarded.server.tcp_port()}, options, {});
    } catch (const ConnectError& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_TRUE(problem("").ends_with(
      "role viewer needs a token, and none was given; give one with --token-file FILE or in INCISE_TOKEN"))
      << problem("");
  EXPECT_TRUE(problem("another token of some").ends_with("does not open role viewer"))
      << problem("another token of some");
}

TEST_F(CommandsTest, WhatCannotBePlayedIsNamed) {
  std::ofstream(directory / "nonsense.csv") << "a,b\n1,2\n";
  StreamCommand command;
  command.poses = directory / "nonsense.csv";
  command.server.address = address();
  try {
    stream(command);
    FAIL();
  } catch (const std::exception& error) {
    EXPECT_NE(std::string(error.what()).find("nonsense.csv"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace incise::client
