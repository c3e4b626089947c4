#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"

namespace incise::core {

// Finds out whether the two sides of a face hang together in another way than through faces that are about to open (TetMarks::pending):
// follows both by turns until they meet, or one has been seen to its end. Costs what the smaller part holds, twice.
class TwoSides {
 public:
  enum class Outcome { kGoesOn, kApart, kTogether };

  explicit TwoSides(CutContext& cut) : cut_(cut), seen_(cut.workspace), other_seen_(cut.workspace) {}

  // Knows of nothing.
  void begin() {
    all_seen_ = 0;
    forget();
  }
  // The same in the middle of its work.
  void forget();
  // After kApart: another pass has taken marks of the part's.
  void mark_again();
  // Goes on with these two, or begins with them; some microseconds of work. kTogether, too, where both are too large (kMaxFarWay).
  Outcome follow(TetId one, TetId other);
  // After kApart: the side that has been seen to its end.
  std::span<const TetId> part() const { return queue_; }
  bool is_in_part(TetId t) const { return seen_.has(t); }

 private:
  Outcome step();

  CutContext& cut_;
  bool follows_ = false;
  bool together_ = false;     // the last two sides that were followed hang together
  std::size_t all_seen_ = 0;  // tetrahedra, since begin()
  TetPass seen_, other_seen_;
  std::vector<TetId> queue_, other_queue_;
  std::size_t next_ = 0, other_next_ = 0;  // in the queues
};

}  // namespace incise::core
