#include "server/core/piece_tracker.hpp"

#include <algorithm>

namespace incise::core {
namespace {

constexpr std::size_t kAhead = 8;  // how far to look ahead in the queue

// Where more than one tetrahedron in so many was visited, going through all of them in order is quicker than sorting.
constexpr std::size_t kScanShare = 16;

}  // namespace

void PieceTracker::claim(TetId t, std::uint32_t group) {
  claims_[t] = {search_, group};
  visited_.push_back(t);
  ++groups_[group].waiting;
}

void PieceTracker::begin() {
  claims_.resize(mesh_.tet_slots(), {0, 0});
  ++search_;
  visited_.clear();
  next_seed_ = next_ = next_relabelled_ = 0;
  groups_.clear();
  changed_.clear();
  searching_.assign(next_piece_, 0);
  undecided_ = 0;
  phase_ = Phase::kSeed;
}

// A group for each tetrahedron that has got a cut face, or had one and was changed.
bool PieceTracker::seed(WorkBudget& budget) {
  const auto touched = mesh_.touched_tets();
  for (; next_seed_ < touched.size(); ++next_seed_) {
    if (budget.spent()) return false;
    budget.charge(1);
    const TetId t = touched[next_seed_];
    if (!mesh_.alive(t) || mesh_.cut_mask(t) == 0) continue;
    const auto group = static_cast<std::uint32_t>(groups_.size());
    const std::uint32_t piece = mesh_.piece(t);
    groups_.push_back({group, 0, piece, 0});
    claim(t, group);
    if (++searching_[piece] == 2) ++undecided_;
  }
  return true;
}

// The queue says what will be needed soon: without this, waiting for memory is most of the search's time.
void PieceTracker::fetch_ahead() const {
  if (next_ + 2 * kAhead < visited_.size()) mesh_.prefetch(visited_[next_ + 2 * kAhead]);
  if (next_ + kAhead >= visited_.size()) return;
  for (int f = 0; f < 4; ++f) {
    const TetId n = mesh_.neighbor(visited_[next_ + kAhead], f);
    if (n != kNone) __builtin_prefetch(&claims_[n]);
  }
}

bool PieceTracker::advance(WorkBudget& budget, Delta& delta) {
  if (phase_ == Phase::kSeed) {
    if (next_seed_ == 0) delta.pieces.clear();
    if (!seed(budget)) return false;
    phase_ = Phase::kSearch;
  }
  if (phase_ == Phase::kSearch) {
    if (!search(budget)) return false;
    phase_ = next_piece_ == searching_.size()                   ? Phase::kNew
             : kScanShare * visited_.size() > mesh_.tet_slots() ? Phase::kScan
                                                                : Phase::kRelabel;
    next_seed_ = 0;
  }
  if (phase_ == Phase::kScan) return relabel_by_scan(budget, delta);
  if (phase_ == Phase::kRelabel) {
    if (!relabel(budget)) return false;
    phase_ = Phase::kNew;
  }
  if (phase_ == Phase::kNew) {
    if (!list_new(budget)) return false;
    changed_.seal();
    phase_ = Phase::kList;
  }
  return list(budget, delta);
}

bool PieceTracker::search(WorkBudget& budget) {
  while (undecided_ > 0 && next_ < visited_.size()) {
    if (budget.spent()) return false;
    budget.charge(1);
    fetch_ahead();
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
  return true;
}

// The new piece that this search has put the tetrahedron into; 0: none.
std::uint32_t PieceTracker::fresh_piece(TetId t) {
  return claims_[t].search == search_ ? groups_[find(claims_[t].group)].fresh : 0;
}

bool PieceTracker::relabel(WorkBudget& budget) {
  for (; next_relabelled_ < visited_.size(); ++next_relabelled_) {
    if (budget.spent()) return false;
    budget.charge(1);
    if (next_relabelled_ + kAhead < visited_.size())
      mesh_.prefetch_piece(visited_[next_relabelled_ + kAhead]);
    const TetId t = visited_[next_relabelled_];
    const std::uint32_t fresh = fresh_piece(t);
    if (fresh == 0) continue;
    mesh_.set_piece(t, fresh);
    changed_.push(std::uint64_t{fresh} << 32 | t);
  }
  return true;
}

// New tetrahedra of pieces other than 0, but for those that are listed already.
bool PieceTracker::list_new(WorkBudget& budget) {
  const auto touched = mesh_.touched_tets();
  for (; next_seed_ < touched.size(); ++next_seed_) {
    if (budget.spent()) return false;
    if (next_seed_ % 4 == 0) budget.charge(1);
    const TetId t = touched[next_seed_];
    if (!mesh_.is_new_tet(t) || !mesh_.alive(t) || mesh_.piece(t) == 0 || fresh_piece(t) != 0) continue;
    changed_.push(std::uint64_t{mesh_.piece(t)} << 32 | t);
  }
  return true;
}

void PieceTracker::append(Delta& delta, std::uint32_t piece, TetId t) {
  auto at = delta.pieces.end();
  while (at != delta.pieces.begin() && (at - 1)->id > piece) --at;
  if (at == delta.pieces.begin() || (at - 1)->id != piece) at = delta.pieces.insert(at, {piece, {}}) + 1;
  (at - 1)->tets.push_back(t);
}

bool PieceTracker::list(WorkBudget& budget, Delta& delta) {
  while (!changed_.empty()) {
    if (budget.spent()) return false;
    budget.charge(2);
    const std::uint64_t key = changed_.take();
    append(delta, static_cast<std::uint32_t>(key >> 32), static_cast<TetId>(key));
  }
  return true;
}

// All of it at once, for what is large: tetrahedra by id.
bool PieceTracker::relabel_by_scan(WorkBudget& budget, Delta& delta) {
  constexpr std::size_t kStride = 64;
  const std::size_t slots = mesh_.tet_slots();
  while (next_relabelled_ < slots) {
    if (budget.spent()) return false;
    budget.charge(kStride / 8);
    const std::size_t end = std::min(next_relabelled_ + kStride, slots);
    for (; next_relabelled_ < end; ++next_relabelled_) {
      const auto t = static_cast<TetId>(next_relabelled_);
      const std::uint32_t fresh = fresh_piece(t);
      if (fresh != 0) {
        mesh_.set_piece(t, fresh);
        append(delta, fresh, t);
      } else if (mesh_.is_new_tet(t) && mesh_.alive(t) && mesh_.piece(t) != 0) {
        append(delta, mesh_.piece(t), t);
      }
    }
  }
  return true;
}

}  // namespace incise::core
