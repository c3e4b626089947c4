#include "server/base/histogram.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <vector>

namespace incise {
namespace {

TEST(Histogram, IsEmptyAtFirst) {
  const Histogram histogram;
  EXPECT_EQ(histogram.count(), 0u);
  EXPECT_EQ(histogram.quantile_ns(0.5), 0u);
  EXPECT_EQ(histogram.max_ns(), 0u);
}

TEST(Histogram, ShortDurationsAreExact) {
  Histogram histogram;
  for (std::int64_t ns = 0; ns < 32; ++ns) histogram.record(ns);
  EXPECT_EQ(histogram.quantile_ns(0.5), 15u);
  EXPECT_EQ(histogram.quantile_ns(1.0), 31u);
  EXPECT_EQ(histogram.sum_ns(), 31u * 32 / 2);
}

TEST(Histogram, QuantilesAreWithinThreePerCentOfTheSortedOnes) {
  const unsigned seed = 20070613;
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937_64 random(seed);
  std::lognormal_distribution<double> durations(12, 2);
  Histogram histogram;
  std::vector<std::uint64_t> sorted;
  for (int i = 0; i < 20'000; ++i) {
    const auto ns = static_cast<std::uint64_t>(durations(random));
    sorted.push_back(ns);
    histogram.record(static_cast<std::int64_t>(ns));
  }
  std::sort(sorted.begin(), sorted.end());
  for (double q : {0.01, 0.5, 0.9, 0.99, 0.999}) {
    const auto exact =
        static_cast<double>(sorted[static_cast<std::size_t>(q * static_cast<double>(sorted.size())) - 1]);
    EXPECT_GE(static_cast<double>(histogram.quantile_ns(q)), exact) << q;
    EXPECT_LE(static_cast<double>(histogram.quantile_ns(q)), 1.04 * exact + 1) << q;
  }
  EXPECT_EQ(histogram.quantile_ns(1.0), sorted.back());
}

TEST(Histogram, NegativeAndEndlessDurationsAreKeptAtTheEnds) {
  Histogram histogram;
  histogram.record(-5);
  EXPECT_EQ(histogram.quantile_ns(1.0), 0u);
  histogram.record(INT64_MAX);
  EXPECT_EQ(histogram.count(), 2u);
  EXPECT_GT(histogram.quantile_ns(1.0), std::uint64_t{1} << 39);
}

}  // namespace
}  // namespace incise
