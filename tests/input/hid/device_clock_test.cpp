#include "server/input/hid/device_clock.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace incise::input {
namespace {

constexpr std::int64_t kStart_ns = 5'000'000'000'000;

// A device that sends every `interval_s` by a clock of 32 bits and 1 us that is off by `drift`; reports arrive 0.2 ms
// later at the least, mostly by 0.1 ms more, now and then by many.
struct Device {
  double interval_s, drift;
  std::mt19937 random{11};
  std::exponential_distribution<double> jitter{1e4};
  std::int64_t measured_ns(int i) const { return kStart_ns + std::llround(i * interval_s * 1e9); }
  std::uint64_t count(int i) const {
    return static_cast<std::uint32_t>(std::llround((i * interval_s * (1 - drift) + 4290) * 1e6));
  }
  std::int64_t arrival_ns(int i) {
    const double late = 2e-4 + jitter(random) + (random() % 500 == 0 ? 0.02 : 0);
    return measured_ns(i) + std::llround(late * 1e9);
  }
};

TEST(DeviceClock, FollowsADriftingDeviceThroughJitter) {
  for (const double drift : {0.0, 1e-4, -1e-4}) {
    Device device{0.001, drift};
    DeviceClock clock(1e-6, 32);
    std::int64_t last = 0, last_arrival = 0;
    double worst = 0;
    for (int i = 0; i < 60'000; ++i) {
      last_arrival = std::max(last_arrival, device.arrival_ns(i));
      const std::int64_t t = clock.host_ns(device.count(i), last_arrival);
      ASSERT_TRUE(i == 0 || t > last) << i;
      last = t;
      if (i > 10'000)
        worst = std::max(worst, std::abs(static_cast<double>(t - device.measured_ns(i)) * 1e-9 - 2e-4));
    }
    EXPECT_LT(worst, 1e-4) << drift;
    EXPECT_NEAR(clock.drift_ppm(), drift * 1e6, 5);
    EXPECT_EQ(clock.restarts(), 0u);  // the counter has turned once on the way
  }
}

// A late first report must not make all later ones late, and the way back must not spoil speeds.
TEST(DeviceClock, RecoversFromALateStartWithoutHaste) {
  DeviceClock clock(1e-6, 32);
  std::int64_t last = clock.host_ns(0, kStart_ns + 50'000'000);
  for (int i = 1; i < 5000; ++i) {
    const std::int64_t t = clock.host_ns(1000u * i, kStart_ns + 1'000'000LL * i);
    ASSERT_GE(t - last, 899'000);
    ASSERT_LE(t - last, 1'101'000);
    last = t;
  }
  EXPECT_NEAR(static_cast<double>(last - kStart_ns) * 1e-9, 4.999, 1e-4);
}

TEST(DeviceClock, CountsTheTurnsOfAShortCounter) {
  DeviceClock clock(0.004, 8);
  for (int i = 0; i < 2000; ++i) {
    if (i > 500 && i < 1300) continue;  // silent for 3.2 s: three turns and a bit
    const std::int64_t t = clock.host_ns(static_cast<std::uint8_t>(i), kStart_ns + 4'000'000LL * i);
    ASSERT_NEAR(static_cast<double>(t - kStart_ns), 4e6 * i, 1e3) << i;
  }
  EXPECT_EQ(clock.restarts(), 0u);
}

TEST(DeviceClock, ARestartBeginsAnewAndTimeStillRises) {
  DeviceClock clock(1e-6, 32);
  std::int64_t last = 0;
  for (int i = 0; i < 2000; ++i) {
    const auto count = static_cast<std::uint32_t>(i < 1000 ? 3000000000LL + 1000 * i : 1000 * (i - 1000));
    const std::int64_t t = clock.host_ns(count, kStart_ns + 1'000'000LL * i);
    ASSERT_GT(t, last);
    ASSERT_NEAR(static_cast<double>(t - kStart_ns), 1e6 * i, 1e4);
    last = t;
  }
  EXPECT_EQ(clock.restarts(), 1u);
}

TEST(DeviceClock, ACountThatStandsStillIsTheSameTime) {
  DeviceClock clock(1e-6, 32);
  const std::int64_t t = clock.host_ns(77, kStart_ns);
  for (int i = 1; i < 100; ++i) EXPECT_EQ(clock.host_ns(77, kStart_ns + 1'000'000LL * i), t);
}

TEST(DeviceClock, ARestartForgetsTheDelaysOfBefore) {
  DeviceClock clock(1e-6, 32);
  // The first report comes late, so all others seem to come early, for two windows and more.
  clock.host_ns(3'000'000'000, kStart_ns + 50'000'000);
  for (int i = 1; i < 2500; ++i) clock.host_ns(3'000'000'000 + 1000u * i, kStart_ns + 1'000'000LL * i);
  const std::int64_t again_ns = kStart_ns + 4'000'000'000;
  std::int64_t t = clock.host_ns(0, again_ns);
  EXPECT_EQ(clock.restarts(), 1u);
  for (int i = 1; i < 500; ++i) t = clock.host_ns(1000u * i, again_ns + 1'000'000LL * i);
  EXPECT_NEAR(static_cast<double>(t - again_ns), 499e6, 1e6);
}

TEST(DeviceClock, TimeRisesThroughRestartsThatArriveTogether) {
  DeviceClock clock(1e-6, 32);
  std::int64_t last = clock.host_ns(2'000'000'000, kStart_ns);
  for (const std::uint64_t count : {0u, 2'000'000'000u, 0u}) {
    const std::int64_t t = clock.host_ns(count, kStart_ns);
    EXPECT_GT(t, last);
    last = t;
  }
  EXPECT_EQ(clock.restarts(), 3u);
}

}  // namespace
}  // namespace incise::input
