// What the commands say where several hands cut one body.

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "client/cli/blade_table.hpp"
#include "client/cli/commands.hpp"
#include "client/cli/restart_notice.hpp"
#include "protocol/printable.hpp"
#include "tests/stream/mini_loop.hpp"

namespace incise::client {
namespace {

using protocol::Restart;
using protocol::RestartKind;
using protocol::Role;
using stream::TestServer;

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

std::string address_of(const TestServer& test) {
  return "127.0.0.1:" + std::to_string(test.server.tcp_port());
}

protocol::Motion motion_of(std::vector<protocol::PoseSample> samples) {
  protocol::Motion motion;
  motion.samples = std::move(samples);
  motion.has_buttons = motion.has_orientation = true;
  return motion;
}

TEST(RestartNotice, SaysOnceWhoHasUndoneOrResetWhat) {
  EXPECT_EQ(restart_text({RestartKind::Undo, Role::Operator, "left", 1, "left"}, 12),
            "blade \"left\" has undone its last stroke: the body is as it was at revision 12");
  EXPECT_EQ(restart_text({RestartKind::Undo, Role::Admin, "ward 3", 1, "left"}, 12),
            "administrator \"ward 3\" has undone the last stroke of blade \"left\": the body is as it was at "
            "revision 12");
  EXPECT_EQ(restart_text({RestartKind::Reset, Role::Admin, "a\x1b[31m\"b", 0, ""}, 0),
            "administrator \"a?[31m?b\" has reset the body: it is as loaded, all cuts are gone");

  EXPECT_EQ(restart_text({RestartKind::Undo, Role::Operator, "left", 1, "left", {"right"}}, 12),
            "blade \"left\" has undone its last stroke, and with it what \"right\" has cut since: the body "
            "is as it was at "
            "revision 12");
  EXPECT_EQ(restart_text({RestartKind::Undo, Role::Admin, "ward 3", 1, "left", {"a", "b", "c"}}, 12),
            "administrator \"ward 3\" has undone the last stroke of blade \"left\", and with it what \"a\", "
            "\"b\" and \"c\" have cut "
            "since: the body is as it was at revision 12");

  RestartNotice notice;
  const auto said = [&](std::uint64_t session, std::optional<Restart> restart) {
    protocol::Welcome welcome;
    welcome.session = session;
    welcome.restart = std::move(restart);
    ::testing::internal::CaptureStderr();
    notice(welcome);
    return ::testing::internal::GetCapturedStderr();
  };
  const Restart reset{RestartKind::Reset, Role::Admin, "x", 0, ""};
  EXPECT_EQ(said(1, reset), "") << "it came before this client did";
  EXPECT_EQ(said(1, reset), "") << "the same ids: it was connected again";
  EXPECT_EQ(said(2, std::nullopt), "") << "an older server, or another body";
  EXPECT_EQ(said(3, reset),
            "incise: server: administrator \"x\" has reset the body: it is as loaded, all cuts are gone\n");
  EXPECT_EQ(said(4, Restart{}), "") << "of a kind that is not known here";
}

TEST(BladeTable, FitsInto80Columns) {
  EXPECT_EQ(blade_table({}), "");
  const auto lines = lines_of(
      blade_table({{0, "left", 4000, 3, 2, 310, true},
                   {7, std::string(300, 'n') + "\n\x1b", UINT32_MAX, 99999, 12345, UINT32_MAX, false}}));
  ASSERT_EQ(lines.size(), 3u);
  EXPECT_EQ(lines[0].find("blade"), 0u);
  EXPECT_EQ(lines[1].find("left "), 0u);
  EXPECT_TRUE(lines[1].ends_with("310  yes")) << lines[1];
  EXPECT_EQ(lines[2].find("nnnn"), 0u);
  for (const std::string& line : lines) EXPECT_LE(line.size(), 80u) << line;
}

// Columns count characters, and none is cut through.
TEST(BladeTable, CutsNamesBetweenCharacters) {
  std::string hand;
  for (int i = 0; i < 30; ++i) hand += "\u5de6";
  const auto lines =
      lines_of(blade_table({{0, "Dr. M\u00fcller", 1, 0, 0, 0, false}, {1, hand, 1, 0, 0, 0, false}}));
  ASSERT_EQ(lines.size(), 3u);
  EXPECT_EQ(lines[1].substr(0, 23), "Dr. M\u00fcller" + std::string(12, ' '));
  EXPECT_EQ(lines[2].substr(0, 63), hand.substr(0, 60) + ".. ");
  EXPECT_EQ(protocol::characters(lines[1]), protocol::characters(lines[2]));
}

// One hand far from the body, while another one cuts it.
TEST(TwoHands, StreamSaysThatItsOwnBladeCutNothingWhileAnotherCuts) {
  TestServer test(6);
  test.loop.start();
  Options options;
  options.role = Role::Operator;
  options.source_name = "left";
  const auto left = Client::connect("127.0.0.1", test.server.tcp_port(), options);
  // While the other one plays for a second.
  std::jthread cutting([&] {
    for (int i = 0; i < 4; ++i) {
      const std::int64_t t0_ns = 1'000'000 + 1'000'000'000 * std::int64_t{i};
      left->send_poses(stream::sweep(0.01 + 0.01 * i, 100, t0_ns, 0.06));
      std::this_thread::sleep_for(std::chrono::milliseconds(200));
    }
  });
  StreamCommand command;
  command.server.address = address_of(test);
  command.source_name = "right";
  command.json = true;
  const auto play = [&](std::vector<protocol::PoseSample> samples, std::string& told) {
    ::testing::internal::CaptureStdout();
    ::testing::internal::CaptureStderr();
    EXPECT_EQ(run_stream(command, motion_of(std::move(samples))), 0);
    told = ::testing::internal::GetCapturedStderr();
    return nlohmann::json::parse(::testing::internal::GetCapturedStdout());
  };
  std::string told;
  auto summary = play(stream::sweep(9, 1000, 1'000'000, 0.06), told);
  EXPECT_EQ(summary["cut_faces"], 0);
  EXPECT_NE(told.find("warning: nothing was cut by blade \"right\": "), std::string::npos) << told;
  cutting.join();
  EXPECT_GT(test.loop.revision(), 0u);
  summary = play(stream::sweep(0.055, 200, 10'000'000'000, 0.06), told);
  EXPECT_GT(summary["cut_faces"], 0);
  EXPECT_EQ(told, "");
}

TEST(TwoHands, WatchShowsTheBladesAndTheirNames) {
  stream::Providers providers;
  providers.statistics = [] {
    protocol::Stats stats;
    stats.frames = 1;
    stats.blades = {{1, "right", 20, 1, 2, 30, true}};
    return stats;
  };
  TestServer test(3, stream::test_config(), std::move(providers));
  test.loop.start();
  WatchCommand watch;
  watch.server.address = address_of(test);
  watch.for_s = 2.4;  // statistics come once a second
  const auto output = [&] {
    ::testing::internal::CaptureStdout();
    EXPECT_EQ(run_watch(watch), 0);
    return lines_of(::testing::internal::GetCapturedStdout());
  };
  auto lines = output();
  EXPECT_TRUE(std::any_of(lines.begin(), lines.end(), [](const std::string& line) {
    return line.starts_with("right ") && line.ends_with("30  yes");
  }));
  for (const std::string& line : lines) EXPECT_LE(line.size(), 80u) << line;
  watch.json = true;
  lines = output();
  ASSERT_FALSE(lines.empty());
  const auto last = nlohmann::json::parse(lines.back());
  EXPECT_EQ(last["pieces"], 1);
  EXPECT_EQ(last["server"]["blades"][0]["name"], "right");
  EXPECT_EQ(last["server"]["blades"][0]["in_stroke"], true);
  EXPECT_EQ(last["server"]["blades"][0]["cut_faces"], 30);
}

// What a program reads of a reset or an undo is a line of its own.
TEST(TwoHands, WatchAsJsonHasALineForAResetAndForAnUndo) {
  TestServer test(3);
  WatchCommand watch;
  watch.server.address = address_of(test);
  watch.for_s = 1.5;
  watch.json = true;
  std::jthread restarting([&] {
    EXPECT_TRUE(stream::eventually([&] { return test.server.counters().peers == 1; }));
    std::uint64_t epoch = 100;
    for (const Restart& restart : {Restart{RestartKind::Undo, Role::Operator, "left", 1, "left", {"right"}},
                                   Restart{RestartKind::Reset, Role::Admin, "ward 3", 0, ""}}) {
      std::this_thread::sleep_for(std::chrono::milliseconds(200));
      auto state = std::make_shared<stream::InitialState>(test.loop.initial());
      state->epoch = ++epoch;
      state->restart = std::make_shared<const Restart>(restart);
      test.server.publish_reset(state);
    }
  });
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  EXPECT_EQ(run_watch(watch), 0);
  ::testing::internal::GetCapturedStderr();
  std::vector<std::string> events;
  for (const std::string& line : lines_of(::testing::internal::GetCapturedStdout()))
    if (nlohmann::json::parse(line).contains("event")) events.push_back(line);
  EXPECT_EQ(
      events,
      (std::vector<std::string>{
          R"({"event":"undo","revision":0,"by":"left","role":"operator","blade":"left","others":["right"]})",
          R"({"event":"reset","revision":0,"by":"ward 3","role":"admin"})"}));
}

// Whoever loses the connection is told what to do, by what is known of the reason.
TEST(TwoHands, StreamSaysWhatToDoWhenItsConnectionEnds) {
  auto test = std::make_unique<TestServer>(3);
  test->loop.start();
  StreamCommand command;
  command.server.address = address_of(*test);
  const auto failure_of = [&](const std::function<void()>& end) {
    std::string what;
    std::jthread playing([&] {
      try {
        run_stream(command, motion_of(stream::sweep(9, 20'000, 1'000'000, 0.06)));
      } catch (const std::exception& error) {
        what = error.what();
      }
    });
    // It plays.
    const std::uint64_t before = test->server.counters().messages_in;
    EXPECT_TRUE(stream::eventually([&] { return test->server.counters().messages_in > before + 10; }));
    end();
    playing.join();
    return what;
  };
  ::testing::internal::CaptureStdout();
  std::unique_ptr<Client> other;
  std::string what = failure_of([&] {
    Options options;
    options.role = Role::Operator;
    options.source_name = command.source_name;
    options.take_over = true;
    other = Client::connect("127.0.0.1", test->server.tcp_port(), options);
  });
  EXPECT_NE(what.find("another operator has taken the blade; it acknowledged "), std::string::npos) << what;
  EXPECT_NE(what.find("; --take-over takes the blade back, --source NAME uses one of your own"),
            std::string::npos)
      << what;
  other.reset();
  EXPECT_TRUE(stream::eventually([&] { return test->loop.open_count() == 0; }));
  what = failure_of([&] { test->server.stop(); });
  EXPECT_NE(what.find("the server stops; it acknowledged "), std::string::npos) << what;
  EXPECT_NE(what.find("; play the motion again when incised runs again"), std::string::npos) << what;
  ::testing::internal::GetCapturedStdout();
}

}  // namespace
}  // namespace incise::client
