#include "server/core/session/piece_tracker.hpp"

#include <algorithm>

#include "server/base/check.hpp"

namespace incise::core {
namespace {

// How many tetrahedra a group may visit in its turn: few at first, since most groups soon meet, then
// more. A group pays for a large cluster with several turns, so all groups grow at the same pace.
constexpr std::int32_t kFirstTurn = 4, kMaxTurn = 256;

}  // namespace

PieceTracker::PieceTracker(const TetMesh& mesh)
    : mesh_(mesh), clusters_(mesh), piece_tets_{mesh.live_tets()}, names_{kNone} {}

PieceTracker::PieceTracker(const TetMesh& mesh, const TetClusters& clusters)
    : mesh_(mesh), clusters_(mesh, clusters), piece_tets_{mesh.live_tets()}, names_{kNone} {}

void PieceTracker::archive(Archive& io) {
  io(next_piece_);
  io.demand(next_piece_ >= 1 && next_piece_ <= mesh_.tet_slots() + 1, "more pieces than tetrahedra");
  if (io.failed()) return;
  clusters_.archive(io, next_piece_);
  io.list(names_, 4, [&](TetId& tet) { io(tet); });
  io.demand(names_.size() == next_piece_, "pieces and their names differ in number");
  if (!io.reads() || io.failed()) return;
  piece_tets_.assign(next_piece_, 0);
  for (TetId t = 0; t < mesh_.tet_slots(); ++t) {
    if (mesh_.alive(t)) ++piece_tets_[piece(t)];
  }
  for (std::uint32_t p = 1; p < next_piece_; ++p) {
    const TetId t = names_[p];
    io.demand(piece_tets_[p] == 0 || (t < mesh_.tet_slots() && mesh_.alive(t) && piece(t) == p),
              "a piece is named by a tetrahedron of another");
  }
}

// ------------------------------------------------------------------------------------------------ the search

void PieceTracker::begin() {
  clusters_.grow();
  ++search_;
  visited_.clear();
  loose_.clear();
  next_ = turn_ = 0;
  rounds_ = 0;
  ring_.clear();
  groups_.clear();
  searches_.resize(next_piece_);
  searched_.clear();
  nameless_.clear();
  named_.clear();
  undecided_ = 0;
  phase_ = Phase::kCount;
}

bool PieceTracker::advance(WorkBudget& budget, Delta& delta) {
  const auto then = [this](Phase next) {
    phase_ = next;
    next_ = 0;
  };
  if (phase_ == Phase::kCount) {
    if (!count(budget)) return false;
    then(Phase::kLoosen);
  }
  if (phase_ == Phase::kLoosen) {
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
    then(named_.empty() ? Phase::kFindNames : Phase::kRelabel);
  }
  if (phase_ == Phase::kRelabel) {
    if (!relabel(budget)) return false;
    then(Phase::kFindNames);
  }
  if (!nameless_.empty() && !find_names(budget)) return false;
  name(delta);
  return true;
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

// Counts what the step has made and taken, while all clusters are as they were before it.
bool PieceTracker::count(WorkBudget& budget) {
  const auto touched = mesh_.touched_tets();
  for (; next_ < touched.size(); ++next_) {
    if (budget.spent()) return false;
    budget.charge(1);
    const TetId t = touched[next_];
    if (mesh_.is_new_tet(t)) {
      if (!mesh_.alive(t)) continue;
      const std::uint32_t piece = clusters_.piece(mesh_.elder(t));
      ++piece_tets_[piece];
      loose_.push_back({t, piece});
    } else if (!mesh_.alive(t)) {
      const std::uint32_t piece = clusters_.piece(t);
      --piece_tets_[piece];
      if (names_[piece] == t) nameless_.push_back(piece);
    }
  }
  return true;
}

// Dissolves the clusters of all tetrahedra that this step has touched, before any is formed again.
bool PieceTracker::loosen(WorkBudget& budget) {
  const auto touched = mesh_.touched_tets();
  for (; next_ < touched.size(); ++next_) {
    if (budget.spent()) return false;
    const TetId t = touched[next_];
    if (!mesh_.is_new_tet(t) && clusters_.has(t) && has_other_neighbors(t))
      budget.charge(clusters_.dissolve(t, loose_));
  }
  return true;
}

bool PieceTracker::form(WorkBudget& budget) {
  for (; next_ < loose_.size(); ++next_) {
    if (budget.spent()) return false;
    if (!clusters_.has(loose_[next_].tet)) budget.charge(clusters_.form(loose_[next_]));
  }
  return true;
}

// Starts a group at each node with a tetrahedron that has a new cut face, or had one and was changed.
bool PieceTracker::seed(WorkBudget& budget) {
  const auto touched = mesh_.touched_tets();
  for (; next_ < touched.size(); ++next_) {
    if (budget.spent()) return false;
    budget.charge(1);
    const TetId t = touched[next_];
    if (!mesh_.alive(t) || mesh_.cut_mask(t) == 0) continue;
    const NodeId node = clusters_.node_of(t);
    if (clusters_[node].search == search_) continue;
    const auto group = static_cast<std::uint32_t>(groups_.size());
    const std::uint32_t piece = clusters_[node].piece;
    groups_.push_back({group, kNone, kNone, piece, t, 0, 0, 0});
    ring_.push_back(group);
    claim(node, group);
    if (++search_of(piece).groups == 2) ++undecided_;
  }
  return true;
}

PieceTracker::Search& PieceTracker::search_of(std::uint32_t piece) {
  if (searches_[piece].serial != search_) {
    searches_[piece] = {};
    searches_[piece].serial = search_;
    searched_.push_back(piece);
  }
  return searches_[piece];
}

void PieceTracker::claim(NodeId node, std::uint32_t group) {
  clusters_[node].search = search_;
  clusters_[node].group = group;
  Group& g = groups_[group];
  const auto at = static_cast<std::uint32_t>(visited_.size());
  (g.first == kNone ? g.first : visited_[g.last].next) = at;
  g.last = at;
  g.tets += clusters_[node].tets;
  visited_.push_back({node, kNone});
  clusters_.prefetch_beside(node);
}

// The group reaches a node: it claims it, or merges with the group that has it. Nearly always it has it itself.
inline void PieceTracker::meet(NodeId node, std::uint32_t group) {
  const TetClusters::Node& known = clusters_[node];
  if (known.search != search_) {
    claim(node, group);
  } else if (known.group != group) {
    merge(find(known.group), group);
  }
}

void PieceTracker::merge(std::uint32_t other, std::uint32_t group) {
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
      groups_[group].credit -= static_cast<std::int32_t>(clusters_[taken.node].tets);
      budget.charge(
          clusters_.visit_beside(taken.node, [this, group](NodeId beside) { meet(beside, group); }));
    }
    budget.charge(1);
    if (groups_[group].first == kNone) end_group(group);
    ++turn_;
  }
  for (const std::uint32_t piece : searched_) {
    if (searches_[piece].cut_off == 0) continue;
    piece_tets_[piece] -= searches_[piece].cut_off;
    // Its tetrahedron may lie in what is cut off.
    if (piece != 0) nameless_.push_back(piece);
  }
  return true;
}

// The group has no cluster left to visit.
void PieceTracker::end_group(std::uint32_t group) {
  const std::uint32_t piece = groups_[group].piece, tets = groups_[group].tets;
  Search& of_piece = searches_[piece];
  if (of_piece.finishing) {
    Group& largest = groups_[of_piece.largest];
    std::swap(groups_[group].fresh, largest.fresh);
    piece_tets_[groups_[group].fresh] = tets;
    names_[groups_[group].fresh] = groups_[group].tet;
    of_piece.cut_off += tets - largest.tets;
    of_piece.finishing = false;
    --undecided_;
  } else if (of_piece.groups > 1) {
    // Another group of the piece still goes on: this one is a separate piece.
    groups_[group].fresh = next_piece_++;
    piece_tets_.push_back(tets);
    names_.push_back(groups_[group].tet);
    named_.push_back(groups_[group].fresh);
    of_piece.cut_off += tets;
    if (of_piece.largest == kNone || groups_[of_piece.largest].tets < tets) of_piece.largest = group;
    if (--of_piece.groups == 1) settle(groups_[group].piece);
  }
}

// ------------------------------------------------------------------------------------------------ labels and names

bool PieceTracker::relabel(WorkBudget& budget) {
  for (; next_ < visited_.size(); ++next_) {
    if (budget.spent()) return false;
    TetClusters::Node& node = clusters_[visited_[next_].node];
    const std::uint32_t fresh = groups_[find(node.group)].fresh;
    budget.charge(1);
    if (fresh != 0) node.piece = fresh;
  }
  return true;
}

// A tetrahedron of each nameless piece that has not kept its own: among those that the step has touched, there are some of each part.
bool PieceTracker::find_names(WorkBudget& budget) {
  const auto touched = mesh_.touched_tets();
  if (next_ == 0) {
    std::erase_if(nameless_, [this](std::uint32_t p) {
      return piece_tets_[p] == 0 || (mesh_.alive(names_[p]) && piece(names_[p]) == p);
    });
    std::sort(nameless_.begin(), nameless_.end());
    nameless_.erase(std::unique(nameless_.begin(), nameless_.end()), nameless_.end());
  }
  for (; next_ < touched.size() && !nameless_.empty(); ++next_) {
    if (budget.spent()) return false;
    budget.charge(1);
    const TetId t = touched[next_];
    if (!mesh_.alive(t)) continue;
    const auto at = std::lower_bound(nameless_.begin(), nameless_.end(), piece(t));
    if (at == nameless_.end() || *at != piece(t)) continue;
    names_[*at] = t;
    named_.push_back(*at);
    nameless_.erase(at);
  }
  INCISE_CHECK(nameless_.empty(), nameless_.size());
  return true;
}

std::vector<Delta::Piece> PieceTracker::named() const {
  std::vector<Delta::Piece> all;
  for (std::uint32_t p = 1; p < next_piece_; ++p) {
    if (piece_tets_[p] > 0) all.push_back({p, names_[p], piece_tets_[p]});
  }
  return all;
}

void PieceTracker::name(Delta& delta) {
  std::sort(named_.begin(), named_.end());
  delta.pieces.clear();
  for (const std::uint32_t piece : named_) delta.pieces.push_back({piece, names_[piece], piece_tets_[piece]});
}

}  // namespace incise::core
