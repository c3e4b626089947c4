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
  for (int i = 0; i < 200; ++i) cost.observe(1000, 7000);
  EXPECT_NEAR(cost.ns_per_unit(), 7.0, 0.1);
  EXPECT_NEAR(static_cast<double>(cost.units_in(70'000)), 10'000, 100);
  EXPECT_EQ(cost.units_in(0), 1);
  EXPECT_EQ(cost.units_in(-1000), 1);
}

TEST(CostModel, OneInterruptedSliceDoesNotStopTheWork) {
  CostModel cost;
  for (int i = 0; i < 200; ++i) cost.observe(1000, 10'000);
  cost.observe(1000, 50'000'000);
  EXPECT_LT(cost.ns_per_unit(), 13);
}

}  // namespace
}  // namespace incise::loop
