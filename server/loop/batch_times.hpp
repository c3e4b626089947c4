#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace incise::loop {

// What a batch that waits needs for its delta's times: when the input that made it came, and when the loop drained that.
struct BatchTimes {
  std::int64_t arrival_ns, drain_ns;
};

// Of all batches that wait, oldest first, as CutSession's queue: a ring that grows.
//
// Thread: the loop's.
class BatchTimesQueue {
 public:
  BatchTimesQueue() : ring_(64) {}

  void push(const BatchTimes& times) {
    if (size_ == ring_.size()) {
      std::rotate(ring_.begin(), ring_.begin() + static_cast<std::ptrdiff_t>(first_), ring_.end());
      first_ = 0;
      ring_.resize(2 * ring_.size());
    }
    ring_[(first_ + size_++) % ring_.size()] = times;
  }
  const BatchTimes& oldest() const { return ring_[first_]; }
  void pop() {
    first_ = (first_ + 1) % ring_.size();
    --size_;
  }
  void clear() { size_ = 0; }

 private:
  std::vector<BatchTimes> ring_;
  std::size_t first_ = 0, size_ = 0;
};

}  // namespace incise::loop
