#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "server/stream/published_delta.hpp"

namespace incise::loop {

using stream::PublishedDelta;

// Takes the deltas that the loop publishes, in order. Called on the loop's thread: must not block.
class DeltaSink {
 public:
  virtual ~DeltaSink() = default;
  // Immutable from here on; each reader releases its copy when done.
  virtual void publish(std::shared_ptr<const PublishedDelta> delta) noexcept = 0;
};

// Deltas to be used again: one that all readers have released is filled again, arrays and all, so a steady frame allocates
// nothing. A few go round as long as readers keep up, so that a body that deforms, whose deltas hold a place for each vertex, has no
// more arrays of that size than are needed; behind them is a ring, whose deltas readers are expected to release in the order
// of publishing.
//
// Thread: next_free() and published() from the loop's; releasing from any. A reader may outlive the pool.
class DeltaPool {
 public:
  // `warm`: objects made in advance, with room for the deltas of common batches. `most`: objects at most,
  // which bounds the memory that a reader who has stopped reading can hold.
  explicit DeltaPool(std::size_t warm = 64, std::size_t most = 1u << 16);

  // A delta to fill; null if readers hold `most`.
  std::shared_ptr<PublishedDelta> next_free();
  // The delta from the last next_free() is on its way to the readers.
  void published() {
    if (chosen_ >= kFew) next_ = chosen_ + 1 < deltas_.size() ? chosen_ + 1 : kFew;
  }

  // Objects there are now. From any thread.
  std::size_t size() const { return size_.load(std::memory_order_relaxed); }

 private:
  static constexpr std::size_t kFew = 8;

  const std::size_t most_;
  std::vector<std::shared_ptr<PublishedDelta>> deltas_;  // the few, then the ring, in the order of publishing
  std::size_t next_ = kFew;                              // the oldest of the ring
  std::size_t chosen_ = 0;                               // by the last next_free()
  std::atomic<std::size_t> size_{0};
};

}  // namespace incise::loop
