#include "server/input/hid/pose_decoder.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>

namespace incise::input {
namespace {

using core::Pose;
using core::Quat;
using core::Vec3;

constexpr std::int64_t kMs = 1'000'000;

DeviceProfile shipped(const std::string& name) {
  return load_profile(std::filesystem::path(INCISE_SOURCE_DIR) / "config/devices" / (name + ".json"));
}

DeviceProfile profile_of(const std::string& rest) {
  return parse_profile(R"({"name": "Test", "vendor": "1", "product": "2", )" + rest + "}", "test.json");
}

std::vector<std::uint8_t> bytes16(std::uint8_t number, std::initializer_list<int> values) {
  std::vector<std::uint8_t> bytes;
  if (number != 0) bytes.push_back(number);
  for (const int value : values) {
    bytes.push_back(static_cast<std::uint8_t>(value));
    bytes.push_back(static_cast<std::uint8_t>(value >> 8));
  }
  return bytes;
}

constexpr const char* kXyzQuat =
    R"("position": {"x": {"at": 0, "type": "i16", "scale": 0.001}, "y": {"at": 2, "type": "i16", "scale": 0.001},
                    "z": {"at": 4, "type": "i16", "scale": 0.001}},
       "rotation": {"mode": "quaternion", "w": {"at": 6, "type": "i16"}, "x": {"at": 8, "type": "i16"},
                    "y": {"at": 10, "type": "i16"}, "z": {"at": 12, "type": "i16"}})";

// Near enough to unit length whatever its numbers mean: the scale is the profile's.
std::string scaled(std::string text) {
  for (std::size_t at = 0; (at = text.find("\"type\": \"i16\"}", at)) != std::string::npos; at += 20) {
    text.replace(at, 14, "\"type\": \"i16\", \"scale\": 0.0001}");
  }
  return text;
}

TEST(PoseDecoder, MapsLeftHandedAxesWithTheirRotations) {
  // The device: x right, y up, z away (left-handed). World: x right, y away, z up.
  PoseDecoder decoder(profile_of(R"("tools": [{)" + scaled(kXyzQuat) +
                                 R"(}], "world": {"x": "x", "y": "z", "z": "y", "scale": 2})"),
                      {{10, 0, 0}, {}, 0.5});
  // A third of a turn about the device's (1, 1, 1): it takes x to y, y to z. In the world: x to z, z to y.
  const auto samples = decoder.decode(bytes16(0, {100, 200, 300, 5000, 5000, 5000, 5000}), kMs);
  ASSERT_EQ(samples.size(), 1u);
  const Pose& pose = samples[0].pose;
  EXPECT_NEAR(core::distance(pose.position, {10.1, 0.3, 0.2}), 0, 1e-12);
  EXPECT_NEAR(core::distance(core::rotate(pose.orientation, {1, 0, 0}), {0, 0, 1}), 0, 1e-12);
  EXPECT_NEAR(core::distance(core::rotate(pose.orientation, {0, 0, 1}), {0, 1, 0}), 0, 1e-12);
  // A force along the world's y is along the device's z.
  EXPECT_NEAR(core::distance(decoder.device_from_world({0, 2, 0}), {0, 0, 2}), 0, 1e-12);
  // A torque about x turns the world's y towards its z, so the device's z towards its y: the other way about x.
  EXPECT_NEAR(core::distance(decoder.device_torque_from_world({2, 0, 0}), {-2, 0, 0}), 0, 1e-12);
  EXPECT_NEAR(core::distance(decoder.device_torque_from_world({0, 2, 0}), {0, 0, -2}), 0, 1e-12);
}

TEST(PoseDecoder, EulerAnglesTurnAboutTheToolsAxesInTheirOrder) {
  PoseDecoder decoder(profile_of(R"("tools": [{"rotation": {"mode": "euler", "order": "zxy",
        "x": {"at": 0, "type": "i16", "scale": 0.017453292519943295},
        "y": {"at": 2, "type": "i16", "scale": 0.017453292519943295},
        "z": {"at": 4, "type": "i16", "scale": 0.017453292519943295}}}])"),
                      {});
  const auto samples = decoder.decode(bytes16(0, {90, 0, 90}), kMs);
  ASSERT_EQ(samples.size(), 1u);
  // About z: tool x is world y. Then about tool x, which is world y: tool z is world x.
  EXPECT_NEAR(core::distance(core::rotate(samples[0].pose.orientation, {1, 0, 0}), {0, 1, 0}), 0, 1e-12);
  EXPECT_NEAR(core::distance(core::rotate(samples[0].pose.orientation, {0, 0, 1}), {1, 0, 0}), 0, 1e-12);
}

TEST(PoseDecoder, ADeflectionIsIntegratedOverTheReportsTimes) {
  PoseDecoder decoder(shipped("3dconnexion_spacenavigator"), {{1, 2, 3}, {}, 1});
  // Pushed all the way along the device's y for a second, by turns with reports of no turn.
  std::span<const PoseDecoder::Sample> samples;
  std::int64_t t = 1000 * kMs;
  for (int i = 0; i <= 125; ++i, t += 8 * kMs) {
    samples = decoder.decode(i % 2 == 0 ? bytes16(1, {0, 350, 0}) : bytes16(2, {0, 0, 0}), t);
    ASSERT_EQ(samples.size(), 1u);
    ASSERT_EQ(samples[0].pose.t_ns, t);
  }
  EXPECT_NEAR(core::distance(samples[0].pose.position, {1, 2 - 0.1, 3}), 0, 1e-9);
  // At rest nothing comes; a long silence is no long motion.
  samples = decoder.decode(bytes16(1, {0, 350, 0}), t + 60'000 * kMs);
  EXPECT_NEAR(samples[0].pose.position.y, 2 - 0.1 - 0.1 * 4 / 125, 1e-9);
  // Within the dead zone nothing moves; half-way it is a quarter as fast, by its curve.
  const double before = samples[0].pose.position.y;
  t += 70'000 * kMs;
  decoder.decode(bytes16(1, {0, 0, 0}), t);
  samples = decoder.decode(bytes16(1, {0, 17, 0}), t + 8 * kMs);
  samples = decoder.decode(bytes16(1, {0, 17, 0}), t + 16 * kMs);
  const double moved = samples[0].pose.position.y;
  EXPECT_LE(std::abs(moved - before), 0.1 * 4 / 125 + 1e-9);
  samples = decoder.decode(bytes16(1, {0, 17, 0}), t + 24 * kMs);
  EXPECT_EQ(samples[0].pose.position.y, moved);
  EXPECT_NEAR((RateShape{0.1, 0.05, 2}.speed(-0.525)), -0.025, 1e-12);
  // The buttons: the first engages, the second brings it home.
  samples = decoder.decode(std::vector<std::uint8_t>{3, 1}, t + 32 * kMs);
  ASSERT_EQ(samples.size(), 1u);
  EXPECT_EQ(samples[0].pose.buttons, 1u);
  samples = decoder.decode(std::vector<std::uint8_t>{3, 2}, t + 40 * kMs);
  EXPECT_EQ(samples[0].pose.buttons, 0u);
  EXPECT_EQ(samples[0].pose.position, (Vec3{1, 2, 3}));
}

TEST(PoseDecoder, AnIntegratedTurnIsOfUnitLengthAndOfTheRightAngle) {
  PoseDecoder decoder(shipped("3dconnexion_spacenavigator"), {});
  std::span<const PoseDecoder::Sample> samples;
  for (int i = 0; i <= 250; ++i) samples = decoder.decode(bytes16(2, {0, 0, -350}), 1000 * kMs + 8 * kMs * i);
  // 2 s at 1 rad/s about the device's -z, which is the world's z.
  const Quat& q = samples[0].pose.orientation;
  EXPECT_NEAR(q.w, std::cos(1.0), 1e-9);
  EXPECT_NEAR(q.z, std::sin(1.0), 1e-9);
}

TEST(PoseDecoder, ReachEndsTheMotion) {
  PoseDecoder decoder(profile_of(R"("report": 1, "tools": [{"position": {"mode": "relative", "reach_m": 0.05,
      "x": {"at": 1, "type": "i8", "scale": 0.001}, "z": {"report": 2, "at": 1, "type": "i8", "scale": 0.001}}}])"),
                      {});
  std::span<const PoseDecoder::Sample> samples;
  for (int i = 0; i < 10; ++i) {
    samples = decoder.decode(std::vector<std::uint8_t>{1, 3}, kMs * (1 + 10 * i));
    samples = decoder.decode(std::vector<std::uint8_t>{2, 0xf6}, kMs * (5 + 10 * i));
  }
  EXPECT_NEAR(core::distance(samples[0].pose.position, {0.03, 0, -0.05}), 0, 1e-12);
}

TEST(PoseDecoder, ReportsThatWaitedTogetherAreSpreadInTime) {
  PoseDecoder decoder(shipped("3dconnexion_spacenavigator"), {});
  std::int64_t last = 0;
  for (int i = 0; i < 10; ++i) {
    const auto samples = decoder.decode(bytes16(1, {0, 0, 0}), 1000 * kMs + i);
    ASSERT_GE(samples[0].pose.t_ns - last, 4 * kMs);
    last = samples[0].pose.t_ns;
  }
}

TEST(PoseDecoder, WhatCannotBeAPoseChangesNothing) {
  PoseDecoder decoder(profile_of(R"("report": 7, "counter": {"at": 1, "type": "u8"}, "tools": [{"position": {
      "x": {"at": 2, "type": "f32"}, "y": {"at": 6, "type": "f32"}, "z": {"at": 10, "type": "f32"}}}])"),
                      {});
  std::vector<std::uint8_t> report(14, 0);
  report[0] = 7;
  report[1] = 1;
  EXPECT_EQ(decoder.decode(report, kMs).size(), 1u);
  report[1] = 2;
  report[8] = 0xc0;
  report[9] = 0x7f;  // a NaN
  EXPECT_EQ(decoder.decode(report, 2 * kMs).size(), 0u);
  report[9] = 0x7f;
  report[8] = 0x80;  // infinity
  EXPECT_EQ(decoder.decode(report, 3 * kMs).size(), 0u);
  EXPECT_EQ(decoder.decode(std::span(report).first(13), 4 * kMs).size(), 0u);
  EXPECT_EQ(decoder.decode(std::span(report).first(0), 5 * kMs).size(), 0u);
  report[8] = report[9] = 0;
  report[1] = 2;
  EXPECT_EQ(decoder.decode(report, 6 * kMs).size(), 1u);
  const ReportCounts& n = decoder.counts();
  EXPECT_EQ(n.reports, 6u);
  EXPECT_EQ(n.bad_values, 2u);
  EXPECT_EQ(n.short_ones, 1u);
  EXPECT_EQ(n.other, 1u);
  EXPECT_EQ(n.lost, 0u);
}

TEST(PoseDecoder, ACounterThatWrapsHasLostNothing) {
  PoseDecoder decoder(profile_of(R"("report": 7, "counter": {"at": 1, "type": "u8"}, "tools": [{"position": {
      "x": {"at": 2, "type": "f32"}, "y": {"at": 6, "type": "f32"}, "z": {"at": 10, "type": "f32"}}}])"),
                      {});
  std::vector<std::uint8_t> report(14, 0);
  report[0] = 7;
  std::int64_t t_ns = 0;
  const auto take = [&](std::uint8_t count) {
    report[1] = count;
    return decoder.decode(report, t_ns += kMs).size();
  };
  const std::vector<std::uint8_t> in_step{253, 254, 255, 0, 1};
  for (const std::uint8_t count : in_step) EXPECT_EQ(take(count), 1u) << int{count};
  EXPECT_EQ(decoder.counts().lost, 0u);
  EXPECT_EQ(take(1), 0u) << "the same report again";
  take(254);
  EXPECT_EQ(decoder.counts().restarts, 1u) << "back by three";
  take(2);
  EXPECT_EQ(decoder.counts().lost, 3u) << "255, 0 and 1";
  EXPECT_EQ(decoder.counts().repeated, 1u);
  EXPECT_EQ(decoder.counts().restarts, 1u);
}

// A real hand, straight from the capture: all of its reports are poses, and most steps are of one tick.
TEST(PoseDecoder, ReadsARealHydra) {
  const char* const data = std::getenv("INCISE_DATA");
  if (!data) GTEST_SKIP() << "INCISE_DATA is not set";
  std::ifstream file(std::string(data) + "/hid/razer_hydra_log.hid");
  if (!file) GTEST_SKIP() << "no hid/razer_hydra_log.hid in INCISE_DATA";
  PoseDecoder decoder(shipped("razer_hydra"), {});
  Vec3 low{9, 9, 9}, high{-9, -9, -9};
  std::size_t poses = 0;
  for (std::string line; std::getline(file, line);) {
    if (!line.starts_with("E:")) continue;
    std::istringstream words(line.substr(2));
    double seconds = 0;
    int count = 0, byte = 0;
    words >> seconds >> count >> std::hex;
    std::vector<std::uint8_t> report;
    while (words >> byte) report.push_back(static_cast<std::uint8_t>(byte));
    for (const auto& sample : decoder.decode(report, std::llround((seconds + 1) * 1e9))) {
      if (sample.tool != 0) continue;
      ++poses;
      const Vec3& p = sample.pose.position;
      extend(p, low, high);
    }
  }
  const ReportCounts& n = decoder.counts();
  EXPECT_GT(n.reports, 4700u);
  EXPECT_EQ(poses + n.repeated, n.reports);
  EXPECT_EQ(n.bad_values, 0u);
  EXPECT_GT(core::distance(low, high), 0.3);
  EXPECT_LT(core::distance(low, high), 2);
}

TEST(PoseDecoder, HomeIsAPlaceAndADirection) {
  PoseDecoder decoder(shipped("3dconnexion_spacenavigator"), {});
  for (int i = 0; i < 50; ++i) decoder.decode(bytes16(2, {0, 0, -350}), 1000 * kMs + 8 * kMs * i);
  const auto turned = decoder.decode(std::vector<std::uint8_t>{3, 0}, 1400 * kMs);
  ASSERT_LT(turned[0].pose.orientation.w, 0.99);
  const auto home = decoder.decode(std::vector<std::uint8_t>{3, 2}, 1408 * kMs);
  EXPECT_EQ(home[0].pose.orientation, Quat{});
}

// Half a turn about x, then a quarter about z: about the device's z, or the one that the tool has by then.
TEST(PoseDecoder, TurnsAreAboutTheAxesOfTheirFrame) {
  for (const bool tool_frame : {false, true}) {
    PoseDecoder decoder(
        profile_of(std::string(R"("rate_hz": 1, "tools": [{"rotation": {"mode": "rate", "frame": ")") +
                   (tool_frame ? "tool" : "device") + R"(", "full_rad_s": 1.5707963267948966,
        "x": {"at": 0, "type": "i16"}, "z": {"at": 2, "type": "i16"}}}])"),
        {});
    const std::int64_t second = 1000 * kMs;
    decoder.decode(bytes16(0, {0, 0}), second);
    decoder.decode(bytes16(0, {1, 0}), 2 * second);
    decoder.decode(bytes16(0, {1, 0}), 3 * second);
    const auto samples = decoder.decode(bytes16(0, {0, 1}), 4 * second);
    const Vec3 x = core::rotate(samples[0].pose.orientation, {1, 0, 0});
    EXPECT_NEAR(core::distance(x, {0, tool_frame ? -1.0 : 1.0, 0}), 0, 1e-9);
  }
}

TEST(PoseDecoder, AClockThatStandsStillRepeatsItsReport) {
  PoseDecoder decoder(
      profile_of(R"("clock": {"at": 0, "type": "u16", "tick_s": 0.001}, "tools": [{"position": {
      "x": {"at": 2, "type": "i16"}}}])"),
      {});
  EXPECT_EQ(decoder.decode(bytes16(0, {5, 1}), 1000 * kMs).size(), 1u);
  EXPECT_EQ(decoder.decode(bytes16(0, {5, 2}), 1001 * kMs).size(), 0u);
  EXPECT_EQ(decoder.counts().repeated, 1u);
  EXPECT_EQ(decoder.decode(bytes16(0, {7, 3}), 1002 * kMs).size(), 1u);
}

}  // namespace
}  // namespace incise::input
