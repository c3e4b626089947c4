#include "server/core/piece_tracker.hpp"

#include <algorithm>

namespace incise::core {

void PieceTracker::claim(TetId t, std::uint32_t group) {
  claims_[t] = {search_, group};
  visited_.push_back(t);
  ++groups_[group].waiting;
}

void PieceTracker::begin() {
  claims_.resize(mesh_.tet_slots(), {0, 0});
  ++search_;
  visited_.clear();
  next_ = 0;
  groups_.clear();
  changed_.clear();
  searching_.assign(next_piece_, 0);
  undecided_ = 0;
  for (TetId t : mesh_.touched_tets()) {
    if (!mesh_.alive(t) || mesh_.cut_mask(t) == 0) continue;
    const auto group = static_cast<std::uint32_t>(groups_.size());
    const std::uint32_t piece = mesh_.piece(t);
    groups_.push_back({group, 0, piece, 0});
    claim(t, group);
    if (++searching_[piece] == 2) ++undecided_;
  }
}

bool PieceTracker::advance(WorkBudget& budget) {
  while (undecided_ > 0 && next_ < visited_.size()) {
    if (budget.spent()) return false;
    budget.charge(1);
    const TetId t = visited_[next_++];
    std::uint32_t group = find(claims_[t].group);
    --groups_[group].waiting;
    for (int f = 0; f < 4; ++f) {
      const TetId n = mesh_.neighbor(t, f);
      if (n == kNone) continue;
      if (claims_[n].search != search_) {
        claim(n, group);
        continue;
      }
      if (claims_[n].group == group) continue;
      const std::uint32_t other = find(claims_[n].group);
      if (other == group) continue;
      // One piece is one component, so both began in the same one.
      groups_[other].parent = group;
      groups_[group].waiting += groups_[other].waiting;
      if (--searching_[groups_[group].piece] == 1) --undecided_;
    }
    if (groups_[group].waiting == 0) {
      // Nowhere left to go, and another group of the piece still has: this is what was cut off.
      std::uint32_t& searching = searching_[groups_[group].piece];
      if (searching > 1) {
        groups_[group].fresh = next_piece_++;
        if (--searching == 1) --undecided_;
      }
    }
  }
  for (TetId t : visited_) {
    const std::uint32_t fresh = groups_[find(claims_[t].group)].fresh;
    if (fresh == 0) continue;
    mesh_.set_piece(t, fresh);
    changed_.push_back(std::uint64_t{fresh} << 32 | t);
  }
  return true;
}

void PieceTracker::report(Delta& delta) {
  delta.pieces.clear();
  for (TetId t : mesh_.touched_tets()) {
    if (!mesh_.alive(t) || !mesh_.is_new_tet(t) || mesh_.piece(t) == 0) continue;
    // Those that this search has put elsewhere are listed already.
    if (claims_[t].search == search_ && claims_[t].group < groups_.size() &&
        groups_[find(claims_[t].group)].fresh != 0)
      continue;
    changed_.push_back(std::uint64_t{mesh_.piece(t)} << 32 | t);
  }
  std::sort(changed_.begin(), changed_.end());
  for (const std::uint64_t change : changed_) {
    const auto piece = static_cast<std::uint32_t>(change >> 32);
    if (delta.pieces.empty() || delta.pieces.back().id != piece) delta.pieces.push_back({piece, {}});
    delta.pieces.back().tets.push_back(static_cast<TetId>(change));
  }
}

}  // namespace incise::core
