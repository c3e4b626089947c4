#include "server/core/piece_tracker.hpp"

#include <algorithm>

namespace incise::core {
namespace {

// What a group may visit before the next one has its turn, in tetrahedra: little at first, for most groups soon meet, then
// more. A cluster is paid for with several turns, so all groups grow at the same pace, whatever they are made of.
constexpr std::int32_t kFirstTurn = 4, kMostTurn = 256;

// Where more than one tetrahedron in so many is in a new piece, going through all of them in order is quicker than sorting.
constexpr std::size_t kScanShare = 16;

// Tetrahedra of a cluster at most: large ones are passed quicker, but more of them dissolves along a cut.
constexpr std::size_t kCluster = 32;

}  // namespace

// ------------------------------------------------------------------------------------------------ clusters

PieceTracker::PieceTracker(TetMesh& mesh) : mesh_(mesh), piece_tets_{mesh.live_tets()} {
  claims_.reserve(room_for(mesh.tet_slots()));
  claims_.resize(mesh.tet_slots(), {0, 0});
  cluster_of_.reserve(room_for(mesh.tet_slots()));
  cluster_of_.resize(mesh.tet_slots(), kNone);
  form_clusters();
  index_clusters();
}

// Breadth first from each tetrahedron that has none yet.
void PieceTracker::form_clusters() {
  std::uint32_t count = 0;
  for (TetId t = 0; t < mesh_.tet_slots(); ++t) {
    if (!mesh_.alive(t) || cluster_of_[t] != kNone) continue;
    TetId members[kCluster] = {t};
    std::size_t size = 1;
    cluster_of_[t] = count;
    for (std::size_t i = 0; i < size; ++i) {
      for (int f = 0; f < 4 && size < kCluster; ++f) {
        const TetId n = mesh_.neighbor(members[i], f);
        if (n == kNone || cluster_of_[n] != kNone) continue;
        cluster_of_[n] = count;
        members[size++] = n;
      }
    }
    ++count;
  }
}

// Makes members and links from cluster_of_.
void PieceTracker::index_clusters() {
  std::uint32_t count = 0;
  for (const std::uint32_t c : cluster_of_) count = c == kNone ? count : std::max(count, c + 1);
  clusters_.assign(count + 1, {0, 0, false});
  for (const std::uint32_t c : cluster_of_) {
    if (c != kNone) ++clusters_[c + 1].members;
  }
  for (std::uint32_t c = 0; c < count; ++c) {
    clusters_[c].whole = clusters_[c + 1].members > 0;
    clusters_[c + 1].members += clusters_[c].members;
  }
  members_.resize(clusters_[count].members);
  std::vector<std::uint32_t> next(count);
  for (std::uint32_t c = 0; c < count; ++c) next[c] = clusters_[c].members;
  for (TetId t = 0; t < cluster_of_.size(); ++t) {
    if (cluster_of_[t] != kNone) members_[next[cluster_of_[t]]++] = t;
  }
  links_.clear();
  for (std::uint32_t c = 0; c < count; ++c) {
    const auto first = static_cast<std::ptrdiff_t>(links_.size());
    clusters_[c].links = static_cast<std::uint32_t>(first);
    for (std::uint32_t m = clusters_[c].members; m < clusters_[c + 1].members; ++m) {
      for (int f = 0; f < 4; ++f) {
        const TetId n = mesh_.neighbor(members_[m], f);
        if (n == kNone || cluster_of_[n] == c) continue;
        if (std::find(links_.begin() + first, links_.end(), cluster_of_[n]) == links_.end())
          links_.push_back(cluster_of_[n]);
      }
    }
  }
  clusters_[count].links = static_cast<std::uint32_t>(links_.size());
  cluster_claims_.assign(count, {0, 0});
}

void PieceTracker::dissolve(std::uint32_t cluster) {
  clusters_[cluster].whole = false;
  for (std::uint32_t m = clusters_[cluster].members; m < clusters_[cluster + 1].members; ++m)
    cluster_of_[members_[m]] = kNone;
}

// ------------------------------------------------------------------------------------------------ the search

void PieceTracker::begin() {
  claims_.resize(mesh_.tet_slots(), {0, 0});
  cluster_of_.resize(mesh_.tet_slots(), kNone);
  ++search_;
  visited_.clear();
  next_seed_ = turn_ = next_relabelled_ = 0;
  rounds_ = 0;
  ring_.clear();
  groups_.clear();
  changed_.clear();
  searches_.assign(next_piece_, {});
  pieces_before_ = next_piece_;
  undecided_ = 0;
  phase_ = Phase::kSeed;
}

bool PieceTracker::advance(WorkBudget& budget, Delta& delta) {
  if (phase_ == Phase::kSeed) {
    if (next_seed_ == 0) delta.pieces.clear();
    if (!seed(budget)) return false;
    phase_ = Phase::kSearch;
  }
  if (phase_ == Phase::kSearch) {
    if (!search(budget)) return false;
    std::size_t cut_off = 0;
    for (std::uint32_t piece = pieces_before_; piece < next_piece_; ++piece) cut_off += piece_tets_[piece];
    phase_ = next_piece_ == pieces_before_              ? Phase::kNew
             : kScanShare * cut_off > mesh_.tet_slots() ? Phase::kScan
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

// Whether what is beside a tetrahedron may have changed in this step, and not only the names of its vertices.
bool PieceTracker::has_other_neighbors(TetId t) const {
  if (!mesh_.alive(t) || mesh_.cut_mask(t) != 0) return true;
  for (int f = 0; f < 4; ++f) {
    const TetId n = mesh_.neighbor(t, f);
    if (n != kNone && mesh_.is_new_tet(n)) return true;
  }
  return false;
}

// A group for each tetrahedron that has got a cut face, or had one and was changed.
bool PieceTracker::seed(WorkBudget& budget) {
  const auto touched = mesh_.touched_tets();
  // First all that is touched becomes loose, for what is a place must not change during the search.
  for (; next_seed_ < touched.size(); ++next_seed_) {
    if (budget.spent()) return false;
    budget.charge(1);
    const TetId t = touched[next_seed_];
    if (mesh_.alive(t) && mesh_.is_new_tet(t)) ++piece_tets_[mesh_.piece(t)];
    if (!mesh_.alive(t) && !mesh_.is_new_tet(t)) --piece_tets_[mesh_.piece(t)];
    if (cluster_of_[t] == kNone || !has_other_neighbors(t)) continue;
    dissolve(cluster_of_[t]);
    budget.charge(4);
  }
  for (; next_seed_ < 2 * touched.size(); ++next_seed_) {
    if (budget.spent()) return false;
    budget.charge(1);
    const TetId t = touched[next_seed_ - touched.size()];
    if (!mesh_.alive(t) || mesh_.cut_mask(t) == 0) continue;
    const auto group = static_cast<std::uint32_t>(groups_.size());
    const std::uint32_t piece = mesh_.piece(t);
    groups_.push_back({group, kNone, kNone, piece, 0, 0, 0});
    ring_.push_back(group);
    claim(t, group);
    if (++searches_[piece].groups == 2) ++undecided_;
  }
  return true;
}

void PieceTracker::claim(Place place, std::uint32_t group) {
  claim_of(place) = {search_, group};
  Group& g = groups_[group];
  const auto at = static_cast<std::uint32_t>(visited_.size());
  (g.first == kNone ? g.first : visited_[g.last].next) = at;
  g.last = at;
  g.tets += size_of(place);
  visited_.push_back({place, kNone});
  if (!(place & kClusterBit)) mesh_.prefetch(place);
}

// The group comes to a place: takes it, or becomes one with the group that has it.
void PieceTracker::meet(Place place, std::uint32_t group) {
  const Claim known = claim_of(place);
  if (known.search != search_) {
    claim(place, group);
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

// From a place to all beside it. Returns the work.
std::int64_t PieceTracker::expand(Place place, std::uint32_t group) {
  if (!(place & kClusterBit)) {
    for (int f = 0; f < 4; ++f) {
      const TetId n = mesh_.neighbor(place, f);
      if (n != kNone) meet(place_of(n), group);
    }
    return 1;
  }
  const std::uint32_t c = place & ~kClusterBit;
  bool beside_loose = false;
  for (std::uint32_t l = clusters_[c].links; l < clusters_[c + 1].links; ++l) {
    const std::uint32_t d = links_[l];
    if (d != kNone && clusters_[d].whole) {
      meet(d | kClusterBit, group);
    } else {
      beside_loose = true;
    }
  }
  if (!beside_loose) return 2;
  for (std::uint32_t m = clusters_[c].members; m < clusters_[c + 1].members; ++m) {
    for (int f = 0; f < 4; ++f) {
      const TetId n = mesh_.neighbor(members_[m], f);
      if (n != kNone && cluster_of_[n] == kNone) meet(n, group);
    }
  }
  return 8;
}

// One group of its piece is left: what is not cut off. Whether that is the largest part is known where all others are
// smaller; else it is visited, too.
void PieceTracker::settle(std::uint32_t piece) {
  Search& of_piece = searches_[piece];
  const std::uint32_t rest = piece_tets_[piece] - of_piece.cut_off;
  if (of_piece.largest != kNone && rest < groups_[of_piece.largest].tets) {
    of_piece.finishing = true;
  } else {
    --undecided_;
  }
}

// Takes the first place that waits in the group, and hints at what the next one will need: waiting for memory is most of
// the search's time.
PieceTracker::Place PieceTracker::take(Group& group) {
  const Visited taken = visited_[group.first];
  group.first = taken.next;
  if (group.first == kNone || visited_[group.first].place & kClusterBit) return taken.place;
  for (int f = 0; f < 4; ++f) {
    const TetId n = mesh_.neighbor(visited_[group.first].place, f);
    if (n == kNone) continue;
    __builtin_prefetch(&claims_[n]);
    __builtin_prefetch(&cluster_of_[n]);
  }
  return taken.place;
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
      // It has become part of another one, or is done, or its piece is decided.
      ring_[turn_] = ring_.back();
      ring_.pop_back();
      budget.charge(1);
      continue;
    }
    groups_[group].credit += std::min(kFirstTurn + rounds_ / 4, kMostTurn);
    while (groups_[group].credit > 0 && groups_[group].first != kNone) {
      const Place place = take(groups_[group]);
      groups_[group].credit -= static_cast<std::int32_t>(size_of(place));
      budget.charge(expand(place, group));
    }
    budget.charge(1);
    if (groups_[group].first == kNone) end_group(group);
    ++turn_;
  }
  for (std::uint32_t piece = 0; piece < pieces_before_; ++piece)
    piece_tets_[piece] -= searches_[piece].cut_off;
  return true;
}

// The group has nowhere left to go.
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
    // Another group of the piece still has: this is a piece of its own.
    groups_[group].fresh = next_piece_++;
    piece_tets_.push_back(tets);
    of_piece.cut_off += tets;
    if (of_piece.largest == kNone || groups_[of_piece.largest].tets < tets) of_piece.largest = group;
    if (--of_piece.groups == 1) settle(groups_[group].piece);
  }
}

// The new piece that this search has put the tetrahedron into; 0: none.
std::uint32_t PieceTracker::fresh_piece(TetId t) {
  const Claim& claim = claim_of(place_of(t));
  return claim.search == search_ ? groups_[find(claim.group)].fresh : 0;
}

// ------------------------------------------------------------------------------------------------ the labels

bool PieceTracker::relabel(WorkBudget& budget) {
  const auto put = [this](TetId t, std::uint32_t fresh) {
    mesh_.set_piece(t, fresh);
    changed_.push(std::uint64_t{fresh} << 32 | t);
  };
  for (; next_relabelled_ < visited_.size(); ++next_relabelled_) {
    if (budget.spent()) return false;
    budget.charge(1);
    const Place place = visited_[next_relabelled_].place;
    const std::uint32_t fresh = groups_[find(claim_of(place).group)].fresh;
    if (fresh == 0) continue;
    if (!(place & kClusterBit)) {
      put(place, fresh);
      continue;
    }
    const std::uint32_t c = place & ~kClusterBit;
    for (std::uint32_t m = clusters_[c].members; m < clusters_[c + 1].members; ++m) put(members_[m], fresh);
    budget.charge(kCluster);
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

bool PieceTracker::list(WorkBudget& budget, Delta& delta) {
  while (!changed_.empty()) {
    if (budget.spent()) return false;
    budget.charge(2);
    const std::uint64_t key = changed_.take();
    append(delta, static_cast<std::uint32_t>(key >> 32), static_cast<TetId>(key));
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
