#include "server/input/spsc_queue.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <memory>
#include <thread>
#include <vector>

namespace incise::input {
namespace {

TEST(SpscQueue, TakesNoMoreThanItsCapacity) {
  SpscQueue<int> queue(5);
  EXPECT_EQ(queue.capacity(), 8u);
  for (int i = 0; i < 8; ++i) EXPECT_TRUE(queue.push(int{i}));
  EXPECT_FALSE(queue.push(8));
  EXPECT_EQ(queue.size(), 8u);
  int value = -1;
  for (int i = 0; i < 8; ++i) {
    ASSERT_TRUE(queue.pop(value));
    EXPECT_EQ(value, i);
  }
  EXPECT_FALSE(queue.pop(value));
}

TEST(SpscQueue, TakesThePartOfASpanThatFits) {
  SpscQueue<int> queue(4);
  const std::array<int, 6> values{1, 2, 3, 4, 5, 6};
  EXPECT_EQ(queue.push(std::span<const int>(values)), 4u);
  EXPECT_EQ(queue.push(std::span<const int>(values)), 0u);
  int value = 0;
  ASSERT_TRUE(queue.pop(value));
  EXPECT_EQ(queue.push(std::span<const int>(values).subspan(4)), 1u);
  for (int wanted : {2, 3, 4, 5}) {
    ASSERT_TRUE(queue.pop(value));
    EXPECT_EQ(value, wanted);
  }
}

TEST(SpscQueue, ARefusedElementStaysWithTheCaller) {
  SpscQueue<std::unique_ptr<int>> queue(2);
  EXPECT_TRUE(queue.push(std::make_unique<int>(1)));
  EXPECT_TRUE(queue.push(std::make_unique<int>(2)));
  auto third = std::make_unique<int>(3);
  EXPECT_FALSE(queue.push(std::move(third)));
  ASSERT_TRUE(third);
  EXPECT_EQ(*third, 3);  // NOLINT(bugprone-use-after-move): what is tested
}

// Both sides at full speed with a small queue, so that it is often full and often empty: under
// ThreadSanitizer this is the proof that the orderings suffice; anywhere, that nothing is lost, doubled or
// torn.
TEST(SpscQueue, TwoThreadsPassEveryElementOnceInOrder) {
  struct Item {
    std::uint64_t number = 0, check = 0;
  };
  constexpr std::uint64_t kItems = 300'000;
  SpscQueue<Item> queue(64);
  std::thread pusher([&] {
    std::vector<Item> chunk;
    std::uint64_t next = 0;
    while (next < kItems) {
      chunk.clear();
      for (std::uint64_t i = 0; i < 1 + next % 7 && next + i < kItems; ++i)
        chunk.push_back({next + i, ~(next + i)});
      const std::size_t taken = queue.push(std::span<const Item>(chunk));
      next += taken;
      if (taken == 0) std::this_thread::yield();
    }
  });
  std::uint64_t next = 0;
  Item item;
  while (next < kItems) {
    if (!queue.pop(item)) {
      std::this_thread::yield();
      continue;
    }
    ASSERT_EQ(item.number, next);
    ASSERT_EQ(item.check, ~next);
    ++next;
  }
  pusher.join();
  EXPECT_EQ(queue.size(), 0u);
}

}  // namespace
}  // namespace incise::input
