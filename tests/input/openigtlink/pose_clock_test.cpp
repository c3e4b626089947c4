#include "server/input/openigtlink/pose_clock.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "server/core/stroke/stroke_builder.hpp"

namespace incise::input::openigtlink {
namespace {

constexpr std::int64_t kMs = 1'000'000, kStart = 77'000 * kMs;

std::vector<std::int64_t> times(PoseClock& clock, const std::vector<std::int64_t>& arrivals) {
  std::vector<std::int64_t> out;
  for (const std::int64_t arrival : arrivals) out.push_back(clock.time_of(0, arrival));
  return out;
}

std::int64_t shortest_step(const std::vector<std::int64_t>& times) {
  std::int64_t step = times[1] - times[0];
  for (std::size_t i = 1; i < times.size(); ++i) step = std::min(step, times[i] - times[i - 1]);
  return step;
}

// `together` poses at a time, a few microseconds apart, as often as makes 100 poses a second.
std::vector<std::int64_t> in_bursts(int poses, int together) {
  std::vector<std::int64_t> arrivals;
  for (int i = 0; i < poses; ++i)
    arrivals.push_back(kStart + (i / together) * together * 10 * kMs + (i % together) * 5000);
  return arrivals;
}

// How many strokes a blade at 0.1 m/s makes, with the limits that are the default.
std::uint32_t strokes_of(const std::vector<std::int64_t>& times) {
  std::uint32_t strokes = 0;
  core::CutConfig config;
  config.blade = {{0, 0, 0}, {0, 0, -0.05}};
  config.always_engaged = true;
  core::StrokeBuilder builder(0, config, 0.005, strokes);
  core::BatchQueue batches;
  for (std::size_t i = 0; i < times.size(); ++i) {
    core::Pose pose;
    pose.t_ns = times[i];
    pose.position.x = 0.001 * static_cast<double>(i);
    EXPECT_TRUE(core::accepted(builder.push(pose, batches))) << i;
  }
  return strokes;
}

TEST(PoseClock, PosesThatArriveTogetherAreNoJump) {
  for (const int together : {1, 2, 5, 10}) {
    PoseClock clock;
    const std::vector<std::int64_t> arrivals = in_bursts(200, together);
    const std::vector<std::int64_t> made = times(clock, arrivals);
    EXPECT_EQ(strokes_of(made), 1u) << together;
    EXPECT_GT(shortest_step(made), 3 * kMs) << together;
    for (std::size_t i = 0; i < made.size(); ++i) {
      EXPECT_GE(made[i], arrivals[i]) << together;
      EXPECT_LE(made[i], arrivals[i] + together * 10 * kMs) << together;
    }
  }
}

// As Wi-Fi does: nothing for 80 ms, then all of it.
TEST(PoseClock, WhatWasHeldUpIsNoJump) {
  std::vector<std::int64_t> arrivals;
  for (int i = 0; i < 400; ++i) {
    const bool held = i % 100 >= 50 && i % 100 < 58;
    arrivals.push_back(kStart + (held ? i / 100 * 100 + 58 : i) * 10 * kMs + (held ? i * 1000 : 0));
  }
  PoseClock clock;
  EXPECT_EQ(strokes_of(times(clock, arrivals)), 1u);
}

TEST(PoseClock, APeerThatKeepsTimeHasItsArrivals) {
  for (const std::int64_t period : {kMs, 10 * kMs, 50 * kMs}) {
    PoseClock clock;
    std::vector<std::int64_t> arrivals;
    for (int i = 0; i < 500; ++i) arrivals.push_back(kStart + i * period);
    const std::vector<std::int64_t> made = times(clock, arrivals);
    EXPECT_EQ(std::vector(made.begin() + 300, made.end()),
              std::vector(arrivals.begin() + 300, arrivals.end()))
        << period;
  }
}

TEST(PoseClock, APauseIsAPause) {
  PoseClock clock;
  std::vector<std::int64_t> arrivals = in_bursts(100, 5);
  const std::int64_t later = arrivals.back() + 1000 * kMs;
  arrivals.push_back(later);
  EXPECT_EQ(times(clock, arrivals).back(), later);
  // Another source of the same peer begins with its own arrival.
  clock.begin();
  EXPECT_EQ(clock.time_of(0, later + kMs), later + kMs);
}

TEST(PoseClock, ThePeersOwnTimesAreTaken) {
  PoseClock clock;
  EXPECT_EQ(clock.time_of(5 * kMs, kStart), 5 * kMs);
  EXPECT_EQ(clock.time_of(6 * kMs, kStart), 6 * kMs);
  EXPECT_GT(clock.time_of(0, kStart), 6 * kMs);
  EXPECT_EQ(clock.restarts(), 0u);
}

}  // namespace
}  // namespace incise::input::openigtlink
