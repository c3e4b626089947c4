#include "server/core/util/run_sorter.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using testing::Random;

struct Key {
  std::uint32_t value, id;
  bool operator<(const Key& other) const {
    return value != other.value ? value < other.value : id < other.id;
  }
  bool operator==(const Key&) const = default;
};

std::vector<Key> sorted_by_runs(RunSorter<Key>& sorter, const std::vector<Key>& keys) {
  sorter.clear();
  for (const Key& key : keys) sorter.push(key);
  sorter.seal();
  std::vector<Key> out;
  while (!sorter.empty()) out.push_back(sorter.take());
  return out;
}

// None, one, around a run, many runs, the last one full or not; equal values; the same sorter again.
TEST(RunSorter, GivesKeysInOrder) {
  const std::uint64_t seed = 11;
  SCOPED_TRACE(seed);
  Random random(seed);
  RunSorter<Key> sorter;
  constexpr std::size_t kRun = RunSorter<Key>::kRun;
  for (const std::size_t count :
       {std::size_t{0}, std::size_t{1}, kRun - 1, kRun, kRun + 1, 7 * kRun, 9 * kRun + 31}) {
    std::vector<Key> keys;
    for (std::uint32_t i = 0; i < count; ++i) keys.push_back({random.below(count < 300 ? 50 : 1000), i});
    std::vector<Key> expected = keys;
    std::sort(expected.begin(), expected.end());
    EXPECT_TRUE(sorted_by_runs(sorter, keys) == expected) << count << " keys";
  }
}

TEST(RunSorter, IsEmptyAfterClear) {
  RunSorter<Key> sorter;
  for (std::uint32_t i = 0; i < 1000; ++i) sorter.push({i, i});
  sorter.seal();
  sorter.take();
  EXPECT_TRUE(sorted_by_runs(sorter, {{3, 0}, {2, 1}}) == (std::vector<Key>{{2, 1}, {3, 0}}));
}

}  // namespace
}  // namespace incise::core
