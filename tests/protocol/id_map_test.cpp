#include "protocol/id_map.hpp"

#include <gtest/gtest.h>

#include <map>
#include <random>

namespace incise::protocol {
namespace {

TEST(IdMap, HoldsWhatAMapHoldsThroughAnyChanges) {
  std::mt19937 random(5);
  IdMap<std::uint32_t> ids;
  std::map<std::uint32_t, std::uint32_t> plain;
  // Close together, as ids are, and some at the ends of pages, of blocks and of all there are.
  const auto below = [&](std::uint32_t n) { return static_cast<std::uint32_t>(random() % n); };
  const auto some_id = [&] {
    switch (below(8)) {
      case 0:
        return 64 * below(100) + 63 * below(2);
      case 1:
        return 4096 * below(5) - below(2);  // 0 - 1 is the largest
      default:
        return below(5000);
    }
  };
  for (int step = 0; step < 40'000; ++step) {
    const std::uint32_t id = some_id();
    // Grows, then empties, in turns.
    if (below(100) < (step / 5000 % 2 == 0 ? 70u : 25u)) {
      ids[id] = plain[id] = static_cast<std::uint32_t>(step);
    } else {
      ids.erase(id);
      plain.erase(id);
    }
    ASSERT_EQ(ids.size(), plain.size());
    const std::uint32_t other = some_id();
    const auto found = plain.find(other);
    ASSERT_EQ(ids.contains(other), found != plain.end());
    if (found != plain.end()) {
      ASSERT_EQ(ids.at(other), found->second);
    }
    if (step % 500 != 0) continue;
    auto next = plain.begin();
    for (const auto& [i, value] : ids) {
      ASSERT_NE(next, plain.end());
      ASSERT_EQ(i, next->first);
      ASSERT_EQ(value, next->second);
      ++next;
    }
    ASSERT_EQ(next, plain.end());
  }
}

TEST(IdMap, ComparesAndRefuses) {
  IdMap<int> a, b;
  EXPECT_TRUE(a == b);
  EXPECT_TRUE(a.begin() == a.end());
  EXPECT_EQ(a.find(0), nullptr);
  EXPECT_THROW(a.at(7), std::out_of_range);
  a[7] = 1;
  EXPECT_FALSE(a == b);
  b[0xffffffff] = 1;
  EXPECT_FALSE(a == b);
  b[7] = 1;
  b.erase(0xffffffff);
  b.erase(8);
  EXPECT_TRUE(a == b);  // whatever room b has kept
  b[7] = 2;
  EXPECT_FALSE(a == b);
}

}  // namespace
}  // namespace incise::protocol
