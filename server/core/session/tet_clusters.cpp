#include "server/core/session/tet_clusters.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include "server/core/util/room.hpp"

namespace incise::core {

TetClusters::TetClusters(const TetMesh& mesh) : mesh_(mesh) {
  reserve_room(cluster_of_, mesh.tet_slots());
  cluster_of_.resize(mesh.tet_slots(), kNone);
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (mesh.alive(t) && !has(t)) form({t, 0});
  }
  pack_members();
  for (std::uint32_t c = 0; c < clusters_.size(); ++c) {
    if (clusters_[c].node.tets != 0) find_links(c);
  }
  form_blocks();
}

// Without the room that clusters were formed in: most of them no step ever touches.
void TetClusters::pack_members() {
  std::vector<TetId> packed;
  reserve_room(packed, mesh_.live_tets());
  for (Cluster& c : clusters_) {
    const auto members = members_of(c);
    c.room = c.node.tets;
    c.members = static_cast<std::uint32_t>(packed.size());
    packed.insert(packed.end(), members.begin(), members.end());
  }
  members_.swap(packed);
}

TetClusters::TetClusters(const TetMesh& copy, const TetClusters& other)
    : mesh_(copy),
      cluster_of_(copy_with_room(other.cluster_of_)),
      members_(copy_with_room(other.members_)),
      clusters_(other.clusters_),
      free_(other.free_),
      blocks_(other.blocks_),
      links_(other.links_),
      block_links_(other.block_links_) {}

void TetClusters::grow() {
  cluster_of_.resize(mesh_.tet_slots(), kNone);
}

// ------------------------------------------------------------------------------------------------ clusters

// Breadth first through tetrahedra that have no cluster.
std::int64_t TetClusters::form(const Loose& loose) {
  std::uint32_t c;
  if (free_.empty()) {
    c = static_cast<std::uint32_t>(clusters_.size());
    clusters_.emplace_back();
  } else {
    c = free_.back();
    free_.pop_back();
  }
  if (clusters_[c].room < kFull) take_room(clusters_[c], kFull);
  TetId* const members = members_.data() + clusters_[c].members;
  cluster_of_[loose.tet] = c;
  members[0] = loose.tet;
  std::uint32_t size = 1;
  for (std::uint32_t i = 0; i < size && size < kFull; ++i) {
    for (int f = 0; f < 4 && size < kFull; ++f) {
      const TetId n = mesh_.neighbor(members[i], f);
      if (n == kNone || has(n)) continue;
      cluster_of_[n] = c;
      mesh_.prefetch(n);
      members[size++] = n;
    }
  }
  // What hangs together now did so before the step.
  clusters_[c].node = {size, loose.piece, 0, 0};
  if (size < kFew && join_cluster(c)) free(c);
  return 1 + size / 3;
}

// Behind all others: memory that no step has used yet has to be cleared first, so most go where others have been.
void TetClusters::take_room(Cluster& c, std::uint32_t count) {
  c.members = static_cast<std::uint32_t>(members_.size());
  c.room = count;
  members_.resize(members_.size() + count);
}

void TetClusters::free(std::uint32_t cluster) {
  Cluster& c = clusters_[cluster];
  const std::uint32_t members = c.members, room = c.room;
  c = {};
  c.members = members;
  c.room = room;
  free_.push_back(cluster);
}

// Puts the members of a cluster before those of the smallest one beside it that has room and that a step has touched, too.
bool TetClusters::join_cluster(std::uint32_t cluster) {
  const Cluster& few = clusters_[cluster];
  std::uint32_t into = kNone;
  for (const TetId t : members_of(few)) {
    for (int f = 0; f < 4; ++f) {
      const TetId n = mesh_.neighbor(t, f);
      const std::uint32_t beside = n == kNone ? kNone : cluster_of_[n];
      if (beside == kNone || beside == cluster || clusters_[beside].links != kNone) continue;
      if (clusters_[beside].node.tets + few.node.tets > kMax) continue;
      if (into == kNone || clusters_[beside].node.tets < clusters_[into].node.tets) into = beside;
    }
  }
  if (into == kNone) return false;
  for (const TetId t : members_of(few)) cluster_of_[t] = into;
  Cluster& joined = clusters_[into];
  const std::uint32_t were_at = joined.members, count = joined.node.tets;
  joined.node.tets += few.node.tets;
  if (joined.room < joined.node.tets) take_room(joined, kMax);
  TetId* const members = members_.data() + joined.members;
  std::memmove(members + few.node.tets, members_.data() + were_at, count * sizeof(TetId));
  std::ranges::copy(members_of(few), members);
  return true;
}

void TetClusters::find_links(std::uint32_t cluster) {
  const auto begin = static_cast<std::ptrdiff_t>(links_.size());
  for (const TetId t : members_of(clusters_[cluster])) {
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

std::int64_t TetClusters::dissolve(TetId tet, std::vector<Loose>& loose) {
  const std::uint32_t cluster = cluster_of_[tet];
  std::int64_t units = 4;
  if (const std::uint32_t block = clusters_[cluster].block; block != kNone) {
    for (std::uint32_t c = blocks_[block].first; c != kNone; c = clusters_[c].next_in_block) {
      clusters_[c].block = kNone;
      clusters_[c].node.piece = blocks_[block].node.piece;
    }
    blocks_[block].first = kNone;
    units += 4;
  }
  const std::uint32_t piece = clusters_[cluster].node.piece;
  const auto members = members_of(clusters_[cluster]);
  for (const TetId t : members) {
    mesh_.prefetch(t);
    cluster_of_[t] = kNone;
  }
  for (const TetId t : members) {
    if (mesh_.alive(t)) loose.push_back({t, piece});
  }
  free(cluster);
  return units;
}

// ------------------------------------------------------------------------------------------------ blocks

// All clusters are in blocks then.
void TetClusters::form_blocks() {
  for (std::uint32_t seed = 0; seed < clusters_.size(); ++seed) {
    if (clusters_[seed].node.tets == 0 || clusters_[seed].block != kNone) continue;
    const std::uint32_t block = begin_block(seed);
    std::uint32_t last = seed, size = 1;
    for (std::uint32_t c = seed; c != kNone && size < kFull; c = clusters_[c].next_in_block) {
      for (std::uint32_t l = clusters_[c].links; l != clusters_[c].links_end && size < kFull; ++l) {
        Cluster& beside = clusters_[links_[l]];
        if (beside.block != kNone) continue;
        beside.block = block;
        blocks_[block].node.tets += beside.node.tets;
        clusters_[last].next_in_block = links_[l];
        last = links_[l];
        ++size;
      }
    }
    if (size < kFew && join_block(block, last)) blocks_.pop_back();
  }
  for (std::uint32_t block = 0; block < blocks_.size(); ++block) find_block_links(block);
}

// Puts the clusters of a block before those of the smallest one beside it that has room.
bool TetClusters::join_block(std::uint32_t block, std::uint32_t last) {
  const Block& few = blocks_[block];
  std::uint32_t into = kNone;
  for (std::uint32_t c = few.first; c != kNone; c = clusters_[c].next_in_block) {
    for (std::uint32_t l = clusters_[c].links; l != clusters_[c].links_end; ++l) {
      const std::uint32_t beside = clusters_[links_[l]].block;
      if (beside == kNone || beside == block) continue;
      if (blocks_[beside].node.tets + few.node.tets > kMax * kFull) continue;
      if (into == kNone || blocks_[beside].node.tets < blocks_[into].node.tets) into = beside;
    }
  }
  if (into == kNone) return false;
  for (std::uint32_t c = few.first; c != kNone; c = clusters_[c].next_in_block) clusters_[c].block = into;
  clusters_[last].next_in_block = blocks_[into].first;
  blocks_[into].first = few.first;
  blocks_[into].node.tets += few.node.tets;
  return true;
}

std::uint32_t TetClusters::begin_block(std::uint32_t cluster) {
  const auto block = static_cast<std::uint32_t>(blocks_.size());
  blocks_.emplace_back();
  blocks_[block].first = cluster;
  blocks_[block].node = {clusters_[cluster].node.tets, clusters_[cluster].node.piece, 0, 0};
  clusters_[cluster].block = block;
  return block;
}

void TetClusters::find_block_links(std::uint32_t block) {
  const auto begin = static_cast<std::ptrdiff_t>(block_links_.size());
  blocks_[block].all_linked = true;
  for (std::uint32_t c = blocks_[block].first; c != kNone; c = clusters_[c].next_in_block) {
    for (std::uint32_t l = clusters_[c].links; l != clusters_[c].links_end; ++l) {
      const std::uint32_t other = clusters_[links_[l]].block;
      if (other == block) continue;
      if (other == kNone) {
        blocks_[block].all_linked = false;
      } else if (std::find(block_links_.begin() + begin, block_links_.end(), other) == block_links_.end()) {
        block_links_.push_back(other);
      }
    }
  }
  blocks_[block].links = static_cast<std::uint32_t>(begin);
  blocks_[block].links_end = static_cast<std::uint32_t>(block_links_.size());
}

// ------------------------------------------------------------------------------------------------ saving

void TetClusters::archive(Archive& io, std::uint32_t pieces) {
  std::vector<std::uint32_t> listed;
  if (!io.reads()) listed = list();
  io.list(listed, 4, [&](std::uint32_t& entry) { io(entry); });
  if (!io.reads() || io.failed()) return;
  io.demand(restore(listed, pieces), "clusters that are not the tetrahedra, each once");
  grow_to(cluster_of_, mesh_.tet_slots());
  grow_to(members_, members_.size());
}

// How many clusters there are; each: size and whether it is linked, piece, members; then each block: how many clusters, which.
std::vector<std::uint32_t> TetClusters::list() const {
  std::vector<std::uint32_t> listed(1, 0), place(clusters_.size(), kNone);
  listed.reserve(mesh_.live_tets() + 3 * clusters_.size());
  // In the order of their first members: a restored session assigns other slots.
  std::vector<std::pair<TetId, std::uint32_t>> in_order;
  for (std::uint32_t number = 0; number < clusters_.size(); ++number) {
    if (clusters_[number].node.tets != 0) in_order.emplace_back(members_[clusters_[number].members], number);
  }
  std::sort(in_order.begin(), in_order.end());
  for (const auto& [first, number] : in_order) {
    const Cluster& c = clusters_[number];
    place[number] = listed[0]++;
    listed.push_back(c.node.tets | (c.links != kNone ? kLinked : 0));
    listed.push_back(piece(first));
    const auto members = members_of(c);
    listed.insert(listed.end(), members.begin(), members.end());
  }
  for (const Block& block : blocks_) {
    if (block.first == kNone) continue;
    const std::size_t size_at = listed.size();
    listed.push_back(0);
    for (std::uint32_t c = block.first; c != kNone; c = clusters_[c].next_in_block) {
      listed.push_back(place[c]);
      ++listed[size_at];
    }
  }
  return listed;
}

bool TetClusters::restore(std::span<const std::uint32_t> listed, std::uint32_t pieces) {
  clusters_.clear();
  free_.clear();
  blocks_.clear();
  links_.clear();
  block_links_.clear();
  cluster_of_.assign(mesh_.tet_slots(), kNone);
  members_.clear();
  if (listed.empty()) return false;
  const std::uint32_t count = listed[0];
  listed = listed.subspan(1);
  std::vector<std::uint32_t> linked;
  std::size_t members = 0;
  for (std::uint32_t c = 0; c < count; ++c) {
    if (listed.size() < 2) return false;
    const std::uint32_t size = listed[0] & ~kLinked, piece = listed[1];
    if (listed[0] & kLinked) linked.push_back(c);
    listed = listed.subspan(2);
    if (size == 0 || size > kMax || size > listed.size() || piece >= pieces) return false;
    for (std::uint32_t i = 0; i < size; ++i) {
      const TetId t = listed[i];
      if (t >= mesh_.tet_slots() || !mesh_.alive(t) || has(t)) return false;
      cluster_of_[t] = c;
    }
    clusters_.emplace_back();
    clusters_[c].members = static_cast<std::uint32_t>(members_.size());
    members_.insert(members_.end(), listed.begin(), listed.begin() + size);
    clusters_[c].room = size;
    clusters_[c].node = {size, piece, 0, 0};
    members += size;
    listed = listed.subspan(size);
  }
  if (members != mesh_.live_tets()) return false;
  // Links to clusters without links are kept as they were: they make searches use the faces.
  for (const std::uint32_t c : linked) find_links(c);
  while (!listed.empty()) {
    const std::uint32_t size = listed[0];
    listed = listed.subspan(1);
    if (size == 0 || size > listed.size()) return false;
    std::uint32_t last = kNone;
    for (std::uint32_t i = 0; i < size; ++i) {
      const std::uint32_t c = listed[i];
      if (c >= count || clusters_[c].block != kNone || clusters_[c].links == kNone) return false;
      if (last == kNone) {
        begin_block(c);
      } else {
        Block& block = blocks_.back();
        if (clusters_[c].node.piece != block.node.piece) return false;
        clusters_[c].block = clusters_[last].block;
        clusters_[last].next_in_block = c;
        block.node.tets += clusters_[c].node.tets;
      }
      last = c;
    }
    listed = listed.subspan(size);
  }
  for (std::uint32_t block = 0; block < blocks_.size(); ++block) find_block_links(block);
  return true;
}

}  // namespace incise::core
