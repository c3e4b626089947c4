#include "server/core/util/id_set.hpp"

#include <gtest/gtest.h>

#include <set>
#include <vector>

#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using testing::Random;

std::vector<std::uint32_t> drain(IdSet& set) {
  std::vector<std::uint32_t> out;
  while (!set.empty()) out.push_back(set.take());
  return out;
}

TEST(IdSet, SaysWhetherAnIdIsNew) {
  IdSet set;
  set.grow(200);
  EXPECT_TRUE(set.empty());
  EXPECT_TRUE(set.insert(63));
  EXPECT_TRUE(set.insert(64));
  EXPECT_FALSE(set.insert(63));
  EXPECT_FALSE(set.empty());
  EXPECT_EQ(drain(set), (std::vector<std::uint32_t>{63, 64}));
  EXPECT_TRUE(set.insert(63)) << "it was taken out";
}

// At the ends of words and of words of the summary.
TEST(IdSet, GivesTheLeastFirstAcrossWords) {
  const std::vector<std::uint32_t> ids{0, 1, 63, 64, 127, 4095, 4096, 4097, 8191, 8192, 262143, 262144};
  IdSet set;
  set.grow(262145);
  for (auto id = ids.rbegin(); id != ids.rend(); ++id) EXPECT_TRUE(set.insert(*id));
  EXPECT_EQ(drain(set), ids);
}

TEST(IdSet, KeepsItsIdsAsItGrowsAndCanBeFilledAgain) {
  const std::uint64_t seed = 5;
  SCOPED_TRACE(seed);
  Random random(seed);
  IdSet set;
  for (std::uint32_t slots = 10; slots < 100000; slots *= 3) {
    set.grow(slots / 2 + 1);
    std::set<std::uint32_t> expected;
    for (int i = 0; i < 300; ++i) {
      if (i == 150) set.grow(slots);
      const std::uint32_t id = random.below(i < 150 ? slots / 2 + 1 : slots);
      EXPECT_EQ(set.insert(id), expected.insert(id).second);
    }
    EXPECT_EQ(drain(set), std::vector<std::uint32_t>(expected.begin(), expected.end())) << slots;
  }
}

}  // namespace
}  // namespace incise::core
