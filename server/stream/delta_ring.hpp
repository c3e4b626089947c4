#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <utility>

#include "server/stream/mirror.hpp"

namespace incise::stream {

// The last steps of a state, as many as fit into `max_bytes`: for peers that return, fall behind, or want fewer a
// second. A Step takes the state from `base_revision` to `revision`, and has bytes(). The loop's steps are one revision each; a relay
// may get several in one, and then nobody can go on from those in between.
//
// Thread: the stream thread.
template <class Step>
class StepRing {
 public:
  explicit StepRing(std::size_t max_bytes) : max_bytes_(max_bytes) {}

  // Adds the next step, and drops the oldest ones until the rest fits; this one too where it is too large.
  void append(Step step) {
    bytes_ += step.bytes();
    steps_.push_back(std::move(step));
    while (!steps_.empty() && bytes_ > max_bytes_) {
      bytes_ -= steps_.front().bytes();
      steps_.pop_front();
    }
  }
  void clear() {
    steps_.clear();
    bytes_ = 0;
  }

  // Whether steps lead from `revision` to `head`.
  bool covers(std::uint64_t revision, std::uint64_t head) const {
    return revision == head ||
           (revision < head && !steps_.empty() && steps_.back().revision == head && find(revision));
  }
  // The step that begins at `revision`, which must be here. O(log n).
  const Step& after(std::uint64_t revision) const { return *find(revision); }

  // Null: none is here.
  const Step* newest() const { return steps_.empty() ? nullptr : &steps_.back(); }

  std::size_t size() const { return steps_.size(); }
  std::size_t bytes() const { return bytes_; }

 private:
  // Null: no step begins there.
  const Step* find(std::uint64_t base) const {
    const auto step = std::lower_bound(steps_.begin(), steps_.end(), base,
                                       [](const Step& s, std::uint64_t r) { return s.base_revision < r; });
    return step != steps_.end() && step->base_revision == base ? &*step : nullptr;
  }

  std::size_t max_bytes_;
  std::size_t bytes_ = 0;
  std::deque<Step> steps_;
};

using DeltaRing = StepRing<EncodedStep>;
using ChangeRing = StepRing<protocol::MeshChange>;

// One delta for all steps from `base` to `head`. Null where it would be longer than a message may be. The ring must
// cover both. O(n log n) in the steps' size.
SharedFrame coalesce(const DeltaRing& ring, protocol::View view, std::uint64_t base, std::uint64_t head);

}  // namespace incise::stream
