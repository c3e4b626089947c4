#include "server/loop/delta_pool.hpp"

#include <gtest/gtest.h>

#include <deque>
#include <set>
#include <thread>
#include <vector>

#include "server/input/spsc_queue.hpp"

namespace incise::loop {
namespace {

TEST(DeltaPool, AFewGoRoundWhileReadersKeepUp) {
  DeltaPool pool(64);
  std::vector<std::shared_ptr<const PublishedDelta>> readers;
  std::set<const PublishedDelta*> seen;
  for (int i = 0; i < 1000; ++i) {
    auto delta = pool.next_free();
    pool.published();
    seen.insert(delta.get());
    readers.push_back(std::move(delta));
    if (readers.size() == 3) readers.erase(readers.begin());
  }
  EXPECT_EQ(seen.size(), 3u);
  EXPECT_EQ(pool.size(), 64u);
}

TEST(DeltaPool, ReadersThatAreLateByManyGoRoundInOrder) {
  DeltaPool pool(2);
  std::deque<std::shared_ptr<const PublishedDelta>> readers;
  for (std::uint64_t i = 0; i < 1000; ++i) {
    auto delta = pool.next_free();
    ASSERT_TRUE(delta);
    delta->delta.revision = i;
    pool.published();
    readers.push_back(std::move(delta));
    if (readers.size() == 20) {
      EXPECT_EQ(readers.front()->delta.revision, i - 19);
      readers.pop_front();
    }
  }
  EXPECT_LE(pool.size(), 20u + 8u) << "what has been released is used again";
}

TEST(DeltaPool, GrowsForASlowReaderUpToItsLimit) {
  DeltaPool pool(2, 5);
  std::vector<std::shared_ptr<const PublishedDelta>> readers;
  for (std::uint64_t i = 0; i < 5; ++i) {
    auto delta = pool.next_free();
    ASSERT_TRUE(delta);
    delta->delta.revision = i;
    pool.published();
    readers.push_back(std::move(delta));
  }
  EXPECT_EQ(pool.size(), 5u);
  EXPECT_FALSE(pool.next_free());
  for (std::uint64_t i = 0; i < 5; ++i) EXPECT_EQ(readers[i]->delta.revision, i);
  readers.erase(readers.begin());
  EXPECT_TRUE(pool.next_free());
  EXPECT_EQ(pool.size(), 5u);
}

// Under ThreadSanitizer: an object is not written again while a reader may still read it.
TEST(DeltaPool, AReaderInAnotherThreadSeesWhatWasPublished) {
  constexpr std::uint64_t kDeltas = 20'000;
  DeltaPool pool(4, 64);
  input::SpscQueue<std::shared_ptr<const PublishedDelta>> queue(128);
  std::thread loop([&] {
    for (std::uint64_t i = 1; i <= kDeltas;) {
      auto delta = pool.next_free();
      if (!delta) {
        std::this_thread::yield();
        continue;
      }
      delta->delta.revision = i;
      delta->delta.moved.assign(3, static_cast<std::uint32_t>(i));
      pool.published();
      ASSERT_TRUE(queue.push(std::shared_ptr<const PublishedDelta>(std::move(delta))));
      ++i;
    }
  });
  for (std::uint64_t next = 1; next <= kDeltas;) {
    std::shared_ptr<const PublishedDelta> delta;
    if (!queue.pop(delta)) {
      std::this_thread::yield();
      continue;
    }
    ASSERT_EQ(delta->delta.revision, next);
    ASSERT_EQ(delta->delta.moved.back(), static_cast<std::uint32_t>(next));
    ++next;
  }
  loop.join();
}

}  // namespace
}  // namespace incise::loop
