#include "server/core/session/piece_tracker.hpp"

#include <algorithm>

namespace incise::core {
namespace {

// How many tetrahedra a group may visit in its turn: few at first, since most groups soon meet, then
// more. A group pays for a large cluster with several turns, so all groups grow at the same pace.
constexpr std::int32_t kFirstTurn = 4, kMaxTurn = 256;

}  // namespace

PieceTracker::PieceTracker(TetMesh& mesh) : mesh_(mesh), clusters_(mesh), piece_tets_{mesh.live_tets()} {}

void PieceTracker::archive(Archive& io) {
  io(next_piece_);
  if (io.reads()) {
    io.demand(next_piece_ >= 1 && next_piece_ <= mesh_.tet_slots() + 1, "more pieces than tetrahedra");
    for (TetId t = 0; t < mesh_.tet_slots() && !io.failed(); ++t)
      io.demand(mesh_.piece(t) < next_piece_, "a tetrahedron is in a piece that does not exist");
    if (io.failed()) return;
    piece_tets_.assign(next_piece_, 0);
    for (TetId t = 0; t < mesh_.tet_slots(); ++t) {
      if (mesh_.alive(t)) ++piece_tets_[mesh_.piece(t)];
    }
  }
  clusters_.archive(io);
}

// ------------------------------------------------------------------------------------------------ the search

void PieceTracker::begin() {
  clusters_.grow();
  changed_.grow(mesh_.tet_slots());
  ++search_;
  visited_.clear();
  loose_.clear();
  next_ = turn_ = 0;
  rounds_ = 0;
  ring_.clear();
  groups_.clear();
  searches_.assign(next_piece_, {});
  pieces_before_ = next_piece_;
  undecided_ = 0;
  phase_ = Phase::kLoosen;
}

bool PieceTracker::advance(WorkBudget& budget, Delta& delta) {
  const auto then = [this](Phase next) {
    phase_ = next;
    next_ = 0;
  };
  if (phase_ == Phase::kLoosen) {
    delta.pieces.clear();
    if (!loosen(budget)) return false;
    then(Phase::kForm);
  }
  if (phase_ == Phase::kForm) {
    if (!form(budget)) return false;
    then(Phase::kSeed);
  }
  if (phase_ == Phase::kSeed) {
    if (!seed(budget)) return false;
    then(Phase::kSearch);
  }
  if (phase_ == Phase::kSearch) {
    if (!search(budget)) return false;
    then(next_piece_ == pieces_before_ ? Phase::kNew : Phase::kRelabel);
  }
  if (phase_ == Phase::kRelabel) {
    if (!relabel(budget)) return false;
    then(Phase::kNew);
  }
  if (phase_ == Phase::kNew) {
    if (!list_new(budget)) return false;
    then(Phase::kList);
  }
  return list(budget, delta);
}

// Whether the neighbours of a tetrahedron may have changed in this step, and not only the ids of its vertices.
bool PieceTracker::has_other_neighbors(TetId t) const {
  if (!mesh_.alive(t) || mesh_.cut_mask(t) != 0) return true;
  for (int f = 0; f < 4; ++f) {
    const TetId n = mesh_.neighbor(t, f);
    if (n != kNone && mesh_.is_new_tet(n)) return true;
  }
  return false;
}

// Dissolves the clusters of all tetrahedra that this step has touched, before any is formed again.
bool PieceTracker::loosen(WorkBudget& budget) {
  const auto touched = mesh_.touched_tets();
  for (; next_ < touched.size(); ++next_) {
    if (budget.spent()) return false;
    budget.charge(1);
    const TetId t = touched[next_];
    if (mesh_.is_new_tet(t)) {
      if (!mesh_.alive(t)) continue;
      ++piece_tets_[mesh_.piece(t)];
      loose_.push_back(t);
    } else {
      if (!mesh_.alive(t)) --piece_tets_[mesh_.piece(t)];
      if (clusters_.of(t) == kNone || !has_other_neighbors(t)) continue;
      clusters_.dissolve(clusters_.of(t), loose_);
      budget.charge(4);
    }
  }
  return true;
}

bool PieceTracker::form(WorkBudget& budget) {
  for (; next_ < loose_.size(); ++next_) {
    if (budget.spent()) return false;
    const TetId t = loose_[next_];
    if (clusters_.of(t) != kNone) continue;
    clusters_.form(t);
    budget.charge(1 + clusters_[clusters_.of(t)].size / 3);
  }
  return true;
}

// Starts a group at each cluster with a tetrahedron that has a new cut face, or had one and was changed.
bool PieceTracker::seed(WorkBudget& budget) {
  const auto touched = mesh_.touched_tets();
  for (; next_ < touched.size(); ++next_) {
    if (budget.spent()) return false;
    budget.charge(1);
    const TetId t = touched[next_];
    if (!mesh_.alive(t) || mesh_.cut_mask(t) == 0 || clusters_[clusters_.of(t)].search == search_) continue;
    const auto group = static_cast<std::uint32_t>(groups_.size());
    const std::uint32_t piece = mesh_.piece(t);
    groups_.push_back({group, kNone, kNone, piece, 0, 0, 0});
    ring_.push_back(group);
    claim(clusters_.of(t), group);
    if (++searches_[piece].groups == 2) ++undecided_;
  }
  return true;
}

void PieceTracker::claim(std::uint32_t cluster, std::uint32_t group) {
  clusters_[cluster].search = search_;
  clusters_[cluster].group = group;
  Group& g = groups_[group];
  const auto at = static_cast<std::uint32_t>(visited_.size());
  (g.first == kNone ? g.first : visited_[g.last].next) = at;
  g.last = at;
  g.tets += clusters_[cluster].size;
  visited_.push_back({cluster, kNone});
}

// The group reaches a cluster: it claims it, or merges with the group that has it.
void PieceTracker::meet(std::uint32_t cluster, std::uint32_t group) {
  const TetClusters::Cluster& known = clusters_[cluster];
  if (known.search != search_) {
    claim(cluster, group);
    return;
  }
  if (known.group == group) return;
  const std::uint32_t other = find(known.group);
  if (other == group) return;
  // One piece is one component, so both began in the same one.
  Group &g = groups_[group], &o = groups_[other];
  o.parent = group;
  g.tets += o.tets;
  if (o.first != kNone) {
    (g.first == kNone ? g.first : visited_[g.last].next) = o.first;
    g.last = o.last;
  }
  const std::uint32_t piece = groups_[group].piece;
  if (--searches_[piece].groups == 1) settle(piece);
}

// One group of its piece is left: the part that is not cut off. If that is smaller than the largest part that is, it
// must be visited to its end, since it loses the id.
void PieceTracker::settle(std::uint32_t piece) {
  Search& of_piece = searches_[piece];
  const std::uint32_t rest = piece_tets_[piece] - of_piece.cut_off;
  if (of_piece.largest != kNone && rest < groups_[of_piece.largest].tets) {
    of_piece.finishing = true;
  } else {
    --undecided_;
  }
}

bool PieceTracker::search(WorkBudget& budget) {
  while (undecided_ > 0 && !ring_.empty()) {
    if (budget.spent()) return false;
    if (turn_ >= ring_.size()) {
      turn_ = 0;
      ++rounds_;
    }
    const std::uint32_t group = ring_[turn_];
    const Search& of_piece = searches_[groups_[group].piece];
    if (groups_[group].parent != group || groups_[group].first == kNone ||
        (of_piece.groups == 1 && !of_piece.finishing)) {
      // It has merged into another one, or is done, or its piece is decided.
      ring_[turn_] = ring_.back();
      ring_.pop_back();
      budget.charge(1);
      continue;
    }
    groups_[group].credit += std::min(kFirstTurn + rounds_ / 4, kMaxTurn);
    while (groups_[group].credit > 0 && groups_[group].first != kNone) {
      const Visited taken = visited_[groups_[group].first];
      groups_[group].first = taken.next;
      groups_[group].credit -= static_cast<std::int32_t>(clusters_[taken.cluster].size);
      budget.charge(clusters_.visit_beside(taken.cluster,
                                           [this, group](std::uint32_t beside) { meet(beside, group); }));
    }
    budget.charge(1);
    if (groups_[group].first == kNone) end_group(group);
    ++turn_;
  }
  for (std::uint32_t piece = 0; piece < pieces_before_; ++piece)
    piece_tets_[piece] -= searches_[piece].cut_off;
  return true;
}

// The group has no cluster left to visit.
void PieceTracker::end_group(std::uint32_t group) {
  Search& of_piece = searches_[groups_[group].piece];
  const std::uint32_t tets = groups_[group].tets;
  if (of_piece.finishing) {
    Group& largest = groups_[of_piece.largest];
    std::swap(groups_[group].fresh, largest.fresh);
    piece_tets_[groups_[group].fresh] = tets;
    of_piece.cut_off += tets - largest.tets;
    of_piece.finishing = false;
    --undecided_;
  } else if (of_piece.groups > 1) {
    // Another group of the piece still goes on: this one is a separate piece.
    groups_[group].fresh = next_piece_++;
    piece_tets_.push_back(tets);
    of_piece.cut_off += tets;
    if (of_piece.largest == kNone || groups_[of_piece.largest].tets < tets) of_piece.largest = group;
    if (--of_piece.groups == 1) settle(groups_[group].piece);
  }
}

// ------------------------------------------------------------------------------------------------ the labels

bool PieceTracker::relabel(WorkBudget& budget) {
  for (; next_ < visited_.size(); ++next_) {
    if (budget.spent()) return false;
    const TetClusters::Cluster& cluster = clusters_[visited_[next_].cluster];
    const std::uint32_t fresh = groups_[find(cluster.group)].fresh;
    budget.charge(1);
    if (fresh == 0) continue;
    budget.charge(cluster.size / 4);
    for (TetId t = cluster.first; t != kNone; t = clusters_.next_member(t)) {
      mesh_.set_piece(t, fresh);
      changed_.insert(t);
    }
  }
  return true;
}

bool PieceTracker::list_new(WorkBudget& budget) {
  const auto touched = mesh_.touched_tets();
  for (; next_ < touched.size(); ++next_) {
    if (budget.spent()) return false;
    if (next_ % 4 == 0) budget.charge(1);
    const TetId t = touched[next_];
    if (mesh_.is_new_tet(t) && mesh_.alive(t) && mesh_.piece(t) != 0) changed_.insert(t);
  }
  return true;
}

bool PieceTracker::list(WorkBudget& budget, Delta& delta) {
  for (std::size_t i = 0; !changed_.empty(); ++i) {
    if (i % 4 == 0) {
      if (budget.spent()) return false;
      budget.charge(1);
    }
    const TetId t = changed_.take();
    append(delta, mesh_.piece(t), t);
  }
  return true;
}

void PieceTracker::append(Delta& delta, std::uint32_t piece, TetId t) {
  auto at = delta.pieces.end();
  while (at != delta.pieces.begin() && (at - 1)->id > piece) --at;
  if (at == delta.pieces.begin() || (at - 1)->id != piece) at = delta.pieces.insert(at, {piece, {}}) + 1;
  (at - 1)->tets.push_back(t);
}

}  // namespace incise::core
