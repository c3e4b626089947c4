#include "server/stream/delta_pace.hpp"

#include <gtest/gtest.h>

#include <memory>

namespace incise::stream {
namespace {

TEST(DeltaPace, WithoutALimitEverythingGoesAtOnce) {
  asio::io_context io{1};
  DeltaPace pace(io);
  const auto keep = std::make_shared<int>();
  EXPECT_FALSE(pace.limited());
  for (int i = 0; i < 100; ++i) EXPECT_TRUE(pace.allow(keep, [] { FAIL(); }));
  EXPECT_EQ(io.poll(), 0u);
}

TEST(DeltaPace, EachWaitEndsInOneCallAndTheNextDelta) {
  asio::io_context io{1};
  DeltaPace pace(io);
  pace.set_rate(50);
  const auto keep = std::make_shared<int>();
  int calls = 0;
  const auto again = [&calls] { ++calls; };
  EXPECT_TRUE(pace.allow(keep, again));
  for (int waits = 1; waits <= 3; ++waits) {
    // Asked twice, it calls once.
    EXPECT_FALSE(pace.allow(keep, again));
    EXPECT_FALSE(pace.allow(keep, again));
    io.restart();
    io.run();
    ASSERT_EQ(calls, waits);
    EXPECT_TRUE(pace.allow(keep, again));
  }
}

TEST(DeltaPace, AnotherRateHoldsFromNowOn) {
  asio::io_context io{1};
  DeltaPace pace(io);
  const auto keep = std::make_shared<int>();
  pace.set_rate(0.001F);
  EXPECT_TRUE(pace.allow(keep, [] {}));
  EXPECT_FALSE(pace.allow(keep, [] {}));
  pace.set_rate(0.001F);
  EXPECT_TRUE(pace.allow(keep, [] {}));
}

TEST(DeltaPace, WhoHasGoneIsNotCalled) {
  asio::io_context io{1};
  DeltaPace pace(io);
  pace.set_rate(50);
  auto keep = std::make_shared<int>();
  EXPECT_TRUE(pace.allow(keep, [] {}));
  EXPECT_FALSE(pace.allow(keep, [] { FAIL(); }));
  keep.reset();
  io.run();
}

}  // namespace
}  // namespace incise::stream
