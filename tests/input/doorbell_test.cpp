#include "server/input/doorbell.hpp"

#include <gtest/gtest.h>

#include <thread>

#include "server/base/clock.hpp"
#include "server/input/spsc_queue.hpp"

namespace incise::input {
namespace {

constexpr std::int64_t kHour_ns = 3'600'000'000'000;

TEST(Doorbell, ARingHoldsUntilItIsForgotten) {
  Doorbell bell;
  EXPECT_FALSE(bell.rung());
  bell.ring();
  bell.ring();
  EXPECT_TRUE(bell.rung());
  EXPECT_TRUE(bell.wait_until(monotonic_ns() + kHour_ns));
  EXPECT_TRUE(bell.wait_until(monotonic_ns() + kHour_ns)) << "waiting does not forget";
  bell.forget();
  EXPECT_FALSE(bell.rung());
}

TEST(Doorbell, WithoutARingItReturnsAtItsTimeAndNotBefore) {
  Doorbell bell;
  const std::int64_t until = monotonic_ns() + 1'000'000;
  EXPECT_FALSE(bell.wait_until(until));
  EXPECT_GE(monotonic_ns(), until);
  EXPECT_FALSE(bell.wait_until(monotonic_ns() - 1)) << "a time that is over";
  bell.ring();
  EXPECT_TRUE(bell.wait_until(monotonic_ns() - 1));
}

// A ring that got lost would leave the taker asleep for an hour.
TEST(Doorbell, NothingThatIsHandedOverWaitsForTheNextTime) {
  constexpr int kCount = 100'000;
  Doorbell bell;
  SpscQueue<int> queue(64);
  std::jthread giver([&] {
    for (int i = 0; i < kCount; ++i) {
      while (!queue.push(i)) std::this_thread::yield();
      bell.ring();
    }
  });
  int next = 0;
  while (next < kCount) {
    ASSERT_TRUE(bell.wait_until(monotonic_ns() + kHour_ns));
    bell.forget();
    int got = 0;
    while (queue.pop(got)) ASSERT_EQ(got, next++);
  }
}

}  // namespace
}  // namespace incise::input
