#include "server/stream/handoff_queue.hpp"

#include <gtest/gtest.h>

#include <memory>
#include <thread>

namespace incise::stream {
namespace {

TEST(HandoffQueue, KeepsTheOrderOverManyBlocks) {
  HandoffQueue<int, 4> queue;
  int value = 0;
  EXPECT_FALSE(queue.pop(value));
  int pushed = 0, popped = 0;
  for (int round = 1; round < 40; ++round) {
    for (int i = 0; i < round; ++i) queue.push(pushed++);
    EXPECT_EQ(queue.size(), static_cast<std::size_t>(pushed - popped));
    for (int i = 0; i < round - round % 3; ++i) {
      ASSERT_TRUE(queue.pop(value));
      EXPECT_EQ(value, popped++);
    }
  }
  while (queue.pop(value)) EXPECT_EQ(value, popped++);
  EXPECT_EQ(popped, pushed);
  EXPECT_EQ(queue.size(), 0u);
}

TEST(HandoffQueue, LetsGoOfWhatWasPopped) {
  HandoffQueue<std::shared_ptr<int>, 4> queue;
  const auto kept = std::make_shared<int>(1);
  for (int i = 0; i < 10; ++i) queue.push(kept);
  std::shared_ptr<int> value;
  for (int i = 0; i < 7; ++i) ASSERT_TRUE(queue.pop(value));
  value.reset();
  EXPECT_EQ(kept.use_count(), 4);
}

TEST(HandoffQueue, PassesAllFromOneThreadToAnother) {
  constexpr std::uint64_t kCount = 300'000;
  HandoffQueue<std::uint64_t, 64> queue;
  std::thread pusher([&] {
    for (std::uint64_t i = 1; i <= kCount; ++i) queue.push(i);
  });
  std::uint64_t value = 0, last = 0;
  while (last < kCount) {
    if (!queue.pop(value)) continue;
    ASSERT_EQ(value, last + 1);
    last = value;
  }
  pusher.join();
  EXPECT_FALSE(queue.pop(value));
}

}  // namespace
}  // namespace incise::stream
