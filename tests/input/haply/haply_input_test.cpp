#include "server/input/haply/haply_input.hpp"

#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <limits>
#include <thread>

#include "server/base/clock.hpp"
#include "tests/input/haply/inverse_service.hpp"
#include "tests/stream/mini_loop.hpp"

namespace incise::input {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;
using stream::eventually;
using tests::force_of;
using tests::inverse_state;
using tests::InverseService;
using Kind = InputEvent::Kind;

HaplyState good(const json& message, const std::string& device = "", const std::string& grip = "") {
  std::string error;
  const auto state = read_haply_state(message.dump(), device, grip, error);
  EXPECT_TRUE(state) << error;
  return state.value_or(HaplyState{});
}

std::string error_of(const json& message) {
  std::string error;
  EXPECT_FALSE(read_haply_state(message.dump(), "", "", error));
  return error;
}

TEST(HaplyMessages, AStateOfAnInverse3AndItsGrip) {
  json message = inverse_state(0.1, -0.2, 0.3, true);
  HaplyState state = good(message);
  EXPECT_EQ(state.device, "049D");
  EXPECT_EQ(state.position, (core::Vec3{0.1, -0.2, 0.3}));
  EXPECT_EQ(state.buttons, 1u);
  json& grip = message["wireless_verse_grip"][0]["state"];
  grip["orientation"] = {{"w", 0.6}, {"x", 0}, {"y", 0.8}, {"z", 0}};
  grip["buttons"] = {{"a", false}, {"b", true}, {"c", true}};
  state = good(message);
  EXPECT_EQ(state.buttons, 6u);
  message["inverse3"][0]["device_id"] = std::string(100, 'x') + "\n";
  EXPECT_EQ(good(message).device, std::string(64, 'x'));
  grip["buttons"] = {{"button_0", true}, {"button_3", true}};
  EXPECT_EQ(good(message).buttons, 9u);
  EXPECT_NEAR(state.orientation.y, 0.8, 1e-12);
  // A wired grip has one button; none at all is no fault.
  message["verse_grip"] = {
      {{"device_id", "7"}, {"state", {{"button", true}, {"orientation", grip["orientation"]}}}}};
  EXPECT_EQ(good(message, "", "7").buttons, 1u);
  message.erase("wireless_verse_grip");
  message.erase("verse_grip");
  EXPECT_EQ(good(message).orientation, core::Quat{});
  // Others than the configured one are not taken for it.
  EXPECT_EQ(good(message, "0000").device, "");
  EXPECT_EQ(good(json::object()).device, "");
}

TEST(HaplyMessages, WhatIsWrongIsNamed) {
  std::string error;
  EXPECT_FALSE(read_haply_state("{\"inverse3\":", "", "", error));
  EXPECT_FALSE(read_haply_state("[1]", "", "", error));
  json message = inverse_state(0, 0, 0, false);
  message["inverse3"][0]["state"]["cursor_position"] = {{"x", 0}, {"y", "up"}, {"z", 0}};
  EXPECT_NE(error_of(message).find("cursor_position"), std::string::npos);
  message["inverse3"][0].erase("state");
  EXPECT_NE(error_of(message).find("cursor_position"), std::string::npos);
  message = inverse_state(0, 0, 0, false);
  message["wireless_verse_grip"][0]["state"]["orientation"] = {{"w", 0}, {"x", 0}, {"y", 0}, {"z", 0}};
  EXPECT_NE(error_of(message).find("orientation"), std::string::npos);
}

TEST(HaplyMessages, AForceInTheWordsOfEachVersion) {
  const json now = json::parse(haply_force("049D", {1, -2, 0.5}, HaplyVersion::k35, true));
  EXPECT_EQ(now["inverse3"][0]["device_id"], "049D");
  EXPECT_EQ(now["inverse3"][0]["commands"]["set_cursor_force"]["vector"],
            (json{{"x", 1.0}, {"y", -2.0}, {"z", 0.5}}));
  EXPECT_EQ(now["session"]["configure"]["profile"]["name"], "incised");
  EXPECT_FALSE(json::parse(haply_force("049D", {}, HaplyVersion::k35, false)).contains("session"));
  const json before = json::parse(haply_force("049D", {1, -2, 0.5}, HaplyVersion::k31, true));
  EXPECT_EQ(before["inverse3"][0]["commands"]["set_cursor_force"]["values"]["y"], -2.0);
  EXPECT_FALSE(before.contains("session"));
}

class Haply : public ::testing::Test {
 protected:
  void SetUp() override { spdlog::set_level(spdlog::level::off); }
  void start(const InverseService& service) {
    HaplyOptions options;
    options.url = service.url();
    options.max_force_n = 2;
    options.placement = {{0, 0, 1}, {0, 0, 0, 1}, 0.5};  // turned half about z
    input = std::make_unique<HaplyInput>(sources, forces, options);
  }
  std::uint64_t count(const std::string& what) const {
    for (const auto& [name, value] : input->status().counts) {
      if (name == what) return value;
    }
    return ~std::uint64_t{0};
  }
  void drain() {
    sources.drain([&](std::uint32_t, const InputEvent& event) {
      events.push_back(event);
      return true;
    });
  }
  bool ended() {
    drain();
    return !events.empty() && events.back().kind == Kind::kEndStroke;
  }

  PoseSources sources{core::Blade{}};
  haptics::ForceSlots forces;
  std::unique_ptr<HaplyInput> input;
  std::vector<InputEvent> events;
};

TEST_F(Haply, StatesBecomePosesAndForcesGoBack) {
  InverseService service([](std::size_t n, const std::string&) {
    return inverse_state(0.001 * static_cast<double>(n), 0.02, 0, n > 2).dump();
  });
  start(service);
  ASSERT_TRUE(eventually([&] {
    drain();
    return events.size() > 5;
  }));
  EXPECT_EQ(events[0].kind, Kind::kOpened);
  for (std::size_t i = 1; i < 6; ++i) {
    const core::Pose& pose = events[i].pose.pose;
    EXPECT_NEAR(pose.position.x, -0.0005 * static_cast<double>(i - 1), 1e-12);
    EXPECT_NEAR(pose.position.y, -0.01, 1e-12);
    EXPECT_NEAR(pose.position.z, 1, 1e-12);
    EXPECT_EQ(pose.buttons, i > 3 ? 1u : 0u);
    EXPECT_TRUE(i == 1 || pose.t_ns > events[i - 1].pose.pose.t_ns);
  }
  EXPECT_EQ(forces[0].limit(), 2);
  // A force reaches the device in its own axes; one above the limit is reduced to it; NaN becomes no force.
  const auto arrives = [&](const core::Vec3& world, const core::Vec3& device) {
    return eventually([&] {
      drain();  // a full queue stops the exchange
      forces[0].write({{world.x, world.y, world.z}, monotonic_ns(), 0});
      const auto force = force_of(service.messages().back());
      return force && std::abs((*force)[0] - device.x) < 1e-9 && std::abs((*force)[1] - device.y) < 1e-9 &&
             std::abs((*force)[2] - device.z) < 1e-9;
    });
  };
  ASSERT_TRUE(arrives({1, 0.5, 0.25}, {-1, -0.5, 0.25}));
  ASSERT_TRUE(arrives({0, 0, -50}, {0, 0, -2}));
  ASSERT_TRUE(arrives({std::numeric_limits<double>::quiet_NaN(), 0, 0}, {}));
  ASSERT_TRUE(arrives({1, 0, 0}, {-1, 0, 0}));
  // What the loop no longer renews fades within 20 ms.
  ASSERT_TRUE(eventually([&] { return *force_of(service.messages().back()) == std::vector<double>(3); }));
  // The end: no force is the last word.
  forces[0].write({{1, 0, 0}, monotonic_ns() + 3'600'000'000'000, 0});
  ASSERT_TRUE(eventually([&] { return (*force_of(service.messages().back()))[0] == -1; }));
  input->stop();
  // It may still be on its way.
  ASSERT_TRUE(eventually([&] { return *force_of(service.messages().back()) == std::vector<double>(3); }));
  EXPECT_TRUE(ended());
  EXPECT_EQ(forces[0].limit(), 0);
  EXPECT_EQ(forces[0].losses(), 1u);
}

TEST_F(Haply, ADeviceThatIsUnpluggedAndPutBack) {
  std::atomic<bool> here{false};
  InverseService service([&](std::size_t, const std::string&) {
    return here ? inverse_state(0, 0, 0, true).dump() : std::string(R"({"inverse3":[],"verse_grip":[]})");
  });
  start(service);
  ASSERT_TRUE(eventually([&] { return count("messages") > 2; }));
  EXPECT_EQ(sources.open_count(), 0u);
  EXPECT_FALSE(force_of(service.messages().back()));
  here = true;
  ASSERT_TRUE(eventually([&] { return sources.is_open("haply"); }));
  here = false;
  ASSERT_TRUE(eventually([&] { return ended() && !sources.is_open("haply"); }));
  EXPECT_EQ(forces[0].losses(), 1u);
  here = true;
  EXPECT_TRUE(eventually([&] { return sources.is_open("haply"); }));
}

TEST_F(Haply, AServiceThatHangsUpIsCalledAgain) {
  InverseService service([&](std::size_t n, const std::string&) -> std::optional<std::string> {
    if (n > 5) return std::nullopt;
    return inverse_state(0, 0, 0, true).dump();
  });
  start(service);
  ASSERT_TRUE(eventually([&] {
    drain();
    return count("connections") >= 2 && count("poses") >= 7;
  }));
  EXPECT_GE(forces[0].losses(), 1u);
}

TEST_F(Haply, AServiceThatFallsSilentHasLostItsDevice) {
  InverseService service([&](std::size_t n, const std::string&) {
    return n > 5 ? std::string(InverseService::kMute) : inverse_state(0, 0, 0, true).dump();
  });
  start(service);
  EXPECT_TRUE(eventually([&] { return ended(); }));
  EXPECT_EQ(forces[0].losses(), 1u);
}

TEST_F(Haply, NonsenseIsCountedAndMuchOfItEndsTheConnection) {
  InverseService service([&](std::size_t n, const std::string&) {
    return n == 1 || n > 4 ? std::string("{\"inverse3\": 7") : inverse_state(0, 0, 0, true).dump();
  });
  start(service);
  EXPECT_TRUE(eventually([&] { return count("connections") >= 2; }));
  drain();
  EXPECT_GE(count("bad_messages"), 33u);
  EXPECT_GE(count("poses"), 3u);
  EXPECT_TRUE(eventually([&] { return ended(); }));
}

TEST_F(Haply, StopsWhileNobodyAnswers) {
  auto service = std::make_unique<InverseService>(
      [](std::size_t, const std::string&) { return std::string(InverseService::kMute); });
  start(*service);
  std::this_thread::sleep_for(50ms);
  input.reset();
  HaplyOptions options;
  options.url = service->url();
  service.reset();
  HaplyInput lonely(sources, forces, options);
  std::this_thread::sleep_for(50ms);
  EXPECT_FALSE(lonely.status().peers[0].connected);
}

}  // namespace
}  // namespace incise::input
