#include "server/core/session/piece_tracker.hpp"

#include <algorithm>

#include "server/core/util/room.hpp"

namespace incise::core {
namespace {

// What a group may visit before the next one has its turn, in tetrahedra: little at first, for most groups soon meet, then
// more. A cluster is paid for with several turns, so all groups grow at the same pace, whatever they are made of.
constexpr std::int32_t kFirstTurn = 4, kMostTurn = 256;

// Tetrahedra of a cluster at most: large ones are passed quicker, but more of them dissolves along a cut.
constexpr std::size_t kCluster = 32;

}  // namespace

// ------------------------------------------------------------------------------------------------ clusters

PieceTracker::PieceTracker(TetMesh& mesh) : mesh_(mesh), piece_tets_{mesh.live_tets()} {
  cluster_of_.reserve(room_for(mesh.tet_slots()));
  cluster_of_.resize(mesh.tet_slots(), kNone);
  next_member_.reserve(room_for(mesh.tet_slots()));
  next_member_.resize(mesh.tet_slots(), kNone);
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (mesh.alive(t) && cluster_of_[t] == kNone) form_cluster(t);
  }
  for (std::uint32_t c = 0; c < clusters_.size(); ++c) find_links(c);
}

// Breadth first through tetrahedra that have no cluster.
void PieceTracker::form_cluster(TetId first) {
  std::uint32_t c;
  if (free_clusters_.empty()) {
    c = static_cast<std::uint32_t>(clusters_.size());
    clusters_.emplace_back();
  } else {
    c = free_clusters_.back();
    free_clusters_.pop_back();
    clusters_[c] = {};
  }
  cluster_of_[first] = c;
  next_member_[first] = kNone;
  TetId last = first;
  std::uint32_t size = 1;
  for (TetId t = first; t != kNone && size < kCluster; t = next_member_[t]) {
    for (int f = 0; f < 4 && size < kCluster; ++f) {
      const TetId n = mesh_.neighbor(t, f);
      if (n == kNone || cluster_of_[n] != kNone) continue;
      cluster_of_[n] = c;
      next_member_[n] = kNone;
      next_member_[last] = n;
      last = n;
      ++size;
    }
  }
  clusters_[c].first = first;
  clusters_[c].size = size;
}

void PieceTracker::find_links(std::uint32_t cluster) {
  const auto begin = static_cast<std::ptrdiff_t>(links_.size());
  for (TetId t = clusters_[cluster].first; t != kNone; t = next_member_[t]) {
    for (int f = 0; f < 4; ++f) {
      const TetId n = mesh_.neighbor(t, f);
      if (n == kNone || cluster_of_[n] == cluster) continue;
      if (std::find(links_.begin() + begin, links_.end(), cluster_of_[n]) == links_.end())
        links_.push_back(cluster_of_[n]);
    }
  }
  clusters_[cluster].links = static_cast<std::uint32_t>(begin);
  clusters_[cluster].links_end = static_cast<std::uint32_t>(links_.size());
}

std::vector<std::uint32_t> PieceTracker::list_clusters() const {
  std::vector<std::uint32_t> listed;
  listed.reserve(mesh_.live_tets() + clusters_.size());
  // By first members: slots are handed out otherwise in a session that was restored.
  for (TetId first = 0; first < cluster_of_.size(); ++first) {
    if (cluster_of_[first] == kNone || clusters_[cluster_of_[first]].first != first) continue;
    const Cluster& c = clusters_[cluster_of_[first]];
    listed.push_back(c.size | (c.links != kNone ? kLinked : 0));
    for (TetId t = c.first; t != kNone; t = next_member_[t]) listed.push_back(t);
  }
  return listed;
}

bool PieceTracker::restore_clusters(std::span<const std::uint32_t> listed) {
  clusters_.clear();
  free_clusters_.clear();
  links_.clear();
  cluster_of_.assign(mesh_.tet_slots(), kNone);
  next_member_.assign(mesh_.tet_slots(), kNone);
  std::vector<std::uint32_t> linked;
  std::size_t members = 0;
  while (!listed.empty()) {
    const std::uint32_t size = listed[0] & ~kLinked;
    if (size == 0 || size > kCluster || size >= listed.size()) return false;
    const auto c = static_cast<std::uint32_t>(clusters_.size());
    if (listed[0] & kLinked) linked.push_back(c);
    for (std::uint32_t i = 1; i <= size; ++i) {
      const TetId t = listed[i];
      if (t >= mesh_.tet_slots() || !mesh_.alive(t) || cluster_of_[t] != kNone) return false;
      cluster_of_[t] = c;
      next_member_[t] = i < size ? listed[i + 1] : kNone;
    }
    clusters_.emplace_back();
    clusters_[c].first = listed[1];
    clusters_[c].size = size;
    members += size;
    listed = listed.subspan(size + 1);
  }
  // What a link to an unlinked cluster says is only that the faces tell: as it was.
  for (const std::uint32_t c : linked) find_links(c);
  return members == mesh_.live_tets();
}

void PieceTracker::archive(Archive& io) {
  io(next_piece_);
  std::vector<std::uint32_t> clusters;
  if (!io.reads()) clusters = list_clusters();
  io.list(clusters, 4, [&](std::uint32_t& entry) { io(entry); });
  if (!io.reads()) return;
  io.demand(next_piece_ >= 1 && next_piece_ <= mesh_.tet_slots() + 1, "more pieces than tetrahedra");
  for (TetId t = 0; t < mesh_.tet_slots() && !io.failed(); ++t)
    io.demand(mesh_.piece(t) < next_piece_, "a tetrahedron is in a piece that does not exist");
  if (io.failed()) return;
  piece_tets_.assign(next_piece_, 0);
  for (TetId t = 0; t < mesh_.tet_slots(); ++t) {
    if (mesh_.alive(t)) ++piece_tets_[mesh_.piece(t)];
  }
  io.demand(restore_clusters(clusters), "clusters that are not the tetrahedra, each once");
  grow_to(cluster_of_, mesh_.tet_slots());
  grow_to(next_member_, mesh_.tet_slots());
}

// Its living members become loose.
void PieceTracker::dissolve(std::uint32_t cluster) {
  for (TetId t = clusters_[cluster].first; t != kNone; t = next_member_[t]) {
    cluster_of_[t] = kNone;
    if (mesh_.alive(t)) loose_.push_back(t);
  }
  clusters_[cluster] = {};
  free_clusters_.push_back(cluster);
}

// ------------------------------------------------------------------------------------------------ the search

void PieceTracker::begin() {
  cluster_of_.resize(mesh_.tet_slots(), kNone);
  next_member_.resize(mesh_.tet_slots(), kNone);
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

// Whether what is beside a tetrahedron may have changed in this step, and not only the names of its vertices.
bool PieceTracker::has_other_neighbors(TetId t) const {
  if (!mesh_.alive(t) || mesh_.cut_mask(t) != 0) return true;
  for (int f = 0; f < 4; ++f) {
    const TetId n = mesh_.neighbor(t, f);
    if (n != kNone && mesh_.is_new_tet(n)) return true;
  }
  return false;
}

// Takes what this step has touched out of its clusters. All of it, before any is formed anew.
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
      if (cluster_of_[t] == kNone || !has_other_neighbors(t)) continue;
      dissolve(cluster_of_[t]);
      budget.charge(4);
    }
  }
  return true;
}

bool PieceTracker::form(WorkBudget& budget) {
  for (; next_ < loose_.size(); ++next_) {
    if (budget.spent()) return false;
    const TetId t = loose_[next_];
    if (cluster_of_[t] != kNone) continue;
    form_cluster(t);
    budget.charge(1 + clusters_[cluster_of_[t]].size / 3);
  }
  return true;
}

// A group for each cluster with a tetrahedron that has got a cut face, or had one and was changed.
bool PieceTracker::seed(WorkBudget& budget) {
  const auto touched = mesh_.touched_tets();
  for (; next_ < touched.size(); ++next_) {
    if (budget.spent()) return false;
    budget.charge(1);
    const TetId t = touched[next_];
    if (!mesh_.alive(t) || mesh_.cut_mask(t) == 0 || clusters_[cluster_of_[t]].search == search_) continue;
    const auto group = static_cast<std::uint32_t>(groups_.size());
    const std::uint32_t piece = mesh_.piece(t);
    groups_.push_back({group, kNone, kNone, piece, 0, 0, 0});
    ring_.push_back(group);
    claim(cluster_of_[t], group);
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

// The group comes to a cluster: takes it, or becomes one with the group that has it.
void PieceTracker::meet(std::uint32_t cluster, std::uint32_t group) {
  const Cluster& known = clusters_[cluster];
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

// From a cluster to all beside it. Returns the work.
std::int64_t PieceTracker::expand(std::uint32_t cluster, std::uint32_t group) {
  const Cluster& c = clusters_[cluster];
  bool all_known = c.links != kNone;
  for (std::uint32_t l = c.links; l != c.links_end; ++l) {
    // Where one beside it was formed anew, only the faces tell.
    if (clusters_[links_[l]].links == kNone) {
      all_known = false;
    } else {
      meet(links_[l], group);
    }
  }
  if (all_known) return 2;
  // First what is beside, without a decision on the way: waiting for memory is most of this.
  std::uint32_t beside[4 * kCluster];
  std::size_t count = 0;
  for (TetId t = c.first; t != kNone; t = next_member_[t]) {
    for (int f = 0; f < 4; ++f) {
      const TetId n = mesh_.neighbor(t, f);
      beside[count] = cluster_of_[n == kNone ? t : n];
      count += beside[count] != cluster;
    }
  }
  std::uint32_t met = cluster;
  for (std::size_t i = 0; i < count; ++i) {
    if (beside[i] == met) continue;
    met = beside[i];
    meet(met, group);
  }
  return 1 + c.size / 4;
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
      const Visited taken = visited_[groups_[group].first];
      groups_[group].first = taken.next;
      groups_[group].credit -= static_cast<std::int32_t>(clusters_[taken.cluster].size);
      budget.charge(expand(taken.cluster, group));
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

// ------------------------------------------------------------------------------------------------ the labels

bool PieceTracker::relabel(WorkBudget& budget) {
  for (; next_ < visited_.size(); ++next_) {
    if (budget.spent()) return false;
    const Cluster& cluster = clusters_[visited_[next_].cluster];
    const std::uint32_t fresh = groups_[find(cluster.group)].fresh;
    budget.charge(1);
    if (fresh == 0) continue;
    budget.charge(cluster.size / 4);
    for (TetId t = cluster.first; t != kNone; t = next_member_[t]) {
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
