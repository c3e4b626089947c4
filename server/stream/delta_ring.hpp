#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>

#include "server/stream/mirror.hpp"

namespace incise::stream {

// The last steps, encoded, as many as fit into so many bytes: for who returns, falls behind, or wants fewer a
// second.
//
// Thread: the stream thread.
class DeltaRing {
 public:
  explicit DeltaRing(std::size_t max_bytes) : max_bytes_(max_bytes) {}

  // The next step; the oldest go until the rest fits, this one included.
  void push(EncodedStep step);
  void clear();

  // Whether a state at `revision` can be brought on to `head` from here.
  bool covers(std::uint64_t revision, std::uint64_t head) const {
    return revision == head || (!steps_.empty() && steps_.front().revision <= revision + 1 &&
                                revision < head && steps_.back().revision == head);
  }
  // The step that takes revision - 1 to `revision`, which must be here.
  const EncodedStep& step(std::uint64_t revision) const { return steps_[revision - steps_.front().revision]; }

  std::size_t size() const { return steps_.size(); }
  std::size_t bytes() const { return bytes_; }

 private:
  std::size_t max_bytes_;
  std::size_t bytes_ = 0;
  std::deque<EncodedStep> steps_;
};

// The one delta that leads from `base` to `head` as the steps between do, one after the other. Null where it
// would be longer than a message may be. The ring must cover both. O(n log n) in the steps' size.
SharedFrame coalesce(const DeltaRing& ring, protocol::View view, std::uint64_t base, std::uint64_t head);

}  // namespace incise::stream
