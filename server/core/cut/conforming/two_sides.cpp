#include "server/core/cut/conforming/two_sides.hpp"

#include <utility>

namespace incise::core {

using namespace tolerance;

void TwoSides::forget() {
  follows_ = together_ = false;
  seen_.begin();
}

void TwoSides::mark_again() {
  seen_.begin();
  for (TetId t : queue_) seen_.add(t);
}

TwoSides::Outcome TwoSides::follow(TetId one, TetId other) {
  if (!follows_) {
    // What was seen to its end last is apart at all of its faces; what hung together last hangs together at all of them.
    const auto seen = [this](TetId t) { return seen_.has(t) || other_seen_.has(t); };
    if (together_ && seen(one) && seen(other)) return Outcome::kTogether;
    if (!together_ && seen_.has(one) != seen_.has(other)) return Outcome::kApart;
    if (all_seen_ > kMaxFarWays) return Outcome::kTogether;
    seen_.begin();
    seen_.add(one);
    queue_.assign(1, one);
    other_seen_.begin();
    other_seen_.add(other);
    other_queue_.assign(1, other);
    next_ = other_next_ = 0;
    follows_ = true;
  }
  const Outcome outcome = step();
  if (outcome == Outcome::kGoesOn) return outcome;
  follows_ = false;
  together_ = outcome == Outcome::kTogether;
  all_seen_ += queue_.size() + other_queue_.size();
  return outcome;
}

// Follows the smaller side a little. What is apart has all been seen by seen_ then.
TwoSides::Outcome TwoSides::step() {
  if (queue_.size() > other_queue_.size()) {
    seen_.swap(other_seen_);
    queue_.swap(other_queue_);
    std::swap(next_, other_next_);
  }
  for (const std::size_t end = next_ + kFarChunk; next_ < end; ++next_) {
    if (next_ == queue_.size()) return Outcome::kApart;
    cut_.work += cost::kLook;
    ++cut_.part_judging;
    for (int f = 0; f < 4; ++f) {
      const HalfFace o = cut_.mesh.opposite(half_face(queue_[next_], f));
      if (o == kNone || cut_.is_pending(o)) continue;
      if (other_seen_.has(tet_of(o))) return Outcome::kTogether;
      if (!seen_.insert(tet_of(o))) continue;
      cut_.mesh.prefetch(tet_of(o));
      queue_.push_back(tet_of(o));
    }
  }
  return queue_.size() + other_queue_.size() > kMaxFarWay ? Outcome::kTogether : Outcome::kGoesOn;
}

}  // namespace incise::core
