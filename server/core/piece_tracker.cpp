#include "server/core/piece_tracker.hpp"

#include <algorithm>
#include <array>

namespace incise::core {
namespace {

constexpr std::size_t kAhead = 8;  // how far to look ahead in the queue

// Sorts ascending, by digits of 11 bits from the lowest (radix sort): a piece may hold half the mesh.
void sort_ids(std::vector<TetId>& ids, std::vector<TetId>& scratch) {
  constexpr std::size_t kFew = 1024;
  if (ids.size() < kFew) {
    std::sort(ids.begin(), ids.end());
    return;
  }
  constexpr int kBits = 11;
  constexpr std::uint32_t kMask = (1u << kBits) - 1;
  scratch.resize(ids.size());
  for (int shift = 0; shift < 32; shift += kBits) {
    std::array<std::uint32_t, kMask + 2> begin{};
    for (const TetId t : ids) ++begin[(t >> shift & kMask) + 1];
    for (std::size_t i = 1; i < begin.size(); ++i) begin[i] += begin[i - 1];
    for (const TetId t : ids) scratch[begin[t >> shift & kMask]++] = t;
    ids.swap(scratch);
  }
}

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
  next_ = next_relabelled_ = 0;
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

// The queue says what will be needed soon: without this, waiting for memory is most of the search's time.
void PieceTracker::fetch_ahead() const {
  if (next_ + 2 * kAhead < visited_.size()) mesh_.prefetch(visited_[next_ + 2 * kAhead]);
  if (next_ + kAhead >= visited_.size()) return;
  for (int f = 0; f < 4; ++f) {
    const TetId n = mesh_.neighbor(visited_[next_ + kAhead], f);
    if (n != kNone) __builtin_prefetch(&claims_[n]);
  }
}

bool PieceTracker::advance(WorkBudget& budget) {
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
  for (; next_relabelled_ < visited_.size(); ++next_relabelled_) {
    if (budget.spent()) return false;
    if (next_relabelled_ % 4 == 0) budget.charge(1);
    if (next_relabelled_ + kAhead < visited_.size())
      mesh_.prefetch_piece(visited_[next_relabelled_ + kAhead]);
    const TetId t = visited_[next_relabelled_];
    const std::uint32_t fresh = groups_[find(claims_[t].group)].fresh;
    if (fresh == 0) continue;
    mesh_.set_piece(t, fresh);
    changed_.push_back({fresh, t});
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
    changed_.push_back({mesh_.piece(t), t});
  }
  std::size_t last = 0;
  for (const auto& [piece, t] : changed_) {
    if (last >= delta.pieces.size() || delta.pieces[last].id != piece) {
      for (last = 0; last < delta.pieces.size() && delta.pieces[last].id != piece; ++last) {
      }
      if (last == delta.pieces.size()) delta.pieces.push_back({piece, {}});
    }
    delta.pieces[last].tets.push_back(t);
  }
  std::sort(delta.pieces.begin(), delta.pieces.end(),
            [](const Delta::Piece& a, const Delta::Piece& b) { return a.id < b.id; });
  for (Delta::Piece& piece : delta.pieces) sort_ids(piece.tets, scratch_);
}

}  // namespace incise::core
