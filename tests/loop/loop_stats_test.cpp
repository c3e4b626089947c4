#include "server/loop/loop_stats.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <thread>

#include "server/loop/cost_model.hpp"

namespace incise::loop {
namespace {

TEST(Published, AReaderNeverSeesAHalfWrittenState) {
  Published<LoopState> published;
  std::atomic<bool> stop{false};
  std::thread writer([&] {
    for (std::uint64_t i = 1; i <= 100'000; ++i) {
      LoopState state;
      state.revision = i;
      state.state_hash = ~i;
      state.cut_area_m2 = static_cast<double>(i);
      published.store(state);
    }
    stop = true;
  });
  std::uint64_t last = 0;
  while (!stop) {
    const LoopState state = published.load();
    if (state.revision == 0) continue;
    ASSERT_EQ(state.state_hash, ~state.revision);
    ASSERT_EQ(state.cut_area_m2, static_cast<double>(state.revision));
    ASSERT_GE(state.revision, last);
    last = state.revision;
  }
  writer.join();
  EXPECT_EQ(published.load().revision, 100'000u);
}

TEST(CostModel, FindsWhatAUnitCosts) {
  CostModel cost;
  for (int i = 0; i < 2000; ++i) cost.observe(1000, 7000, true);
  EXPECT_NEAR(cost.ns_per_unit(), 7.0, 0.1);
  EXPECT_NEAR(static_cast<double>(cost.units_in(70'000)), 10'000, 1000);
  EXPECT_EQ(cost.units_in(0), 1);
  EXPECT_EQ(cost.units_in(-1000), 1);
}

TEST(CostModel, OneInterruptedSliceDoesNotStopTheWork) {
  CostModel cost;
  for (int i = 0; i < 2000; ++i) cost.observe(1000, 10'000, true);
  const std::int64_t before = cost.units_in(20'000);
  cost.observe(1000, 50'000'000, true);
  EXPECT_LT(cost.ns_per_unit(), 13);
  cost.observe(1000, 10'000, true);
  EXPECT_GT(cost.units_in(20'000), before / 2);
  EXPECT_LE(cost.longest_ns(), 500'000);
  for (int i = 0; i < 50; ++i) cost.observe(1000, 10'000, true);
  EXPECT_LT(cost.longest_ns(), 20'000);
}

// Three slices of a batch in four are cheap: a slice is measured by the fourth.
TEST(CostModel, ASliceHasRoomForTheHeavyPhase) {
  CostModel cost;
  for (int i = 0; i < 4000; ++i) cost.observe(500, i % 4 == 0 ? 300'000 : 10'000, true);
  EXPECT_LT(cost.ns_per_unit(), 250);
  EXPECT_LT(static_cast<double>(cost.units_in(20'000)) * 600, 24'000);
  // A beginning and an end cost time that is not the units'.
  for (int i = 0; i < 1000; ++i) cost.observe(1, 100'000, false);
  EXPECT_GT(cost.units_in(20'000), 20);
}

}  // namespace
}  // namespace incise::loop
