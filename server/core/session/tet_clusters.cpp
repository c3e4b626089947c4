#include "server/core/session/tet_clusters.hpp"

#include <algorithm>

#include "server/core/util/room.hpp"

namespace incise::core {

TetClusters::TetClusters(const TetMesh& mesh) : mesh_(mesh) {
  cluster_of_.reserve(room_for(mesh.tet_slots()));
  cluster_of_.resize(mesh.tet_slots(), kNone);
  next_member_.reserve(room_for(mesh.tet_slots()));
  next_member_.resize(mesh.tet_slots(), kNone);
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (mesh.alive(t) && cluster_of_[t] == kNone) form(t);
  }
  for (std::uint32_t c = 0; c < clusters_.size(); ++c) find_links(c);
}

void TetClusters::grow() {
  cluster_of_.resize(mesh_.tet_slots(), kNone);
  next_member_.resize(mesh_.tet_slots(), kNone);
}

// Breadth first through tetrahedra that have no cluster.
void TetClusters::form(TetId first) {
  std::uint32_t c;
  if (free_.empty()) {
    c = static_cast<std::uint32_t>(clusters_.size());
    clusters_.emplace_back();
  } else {
    c = free_.back();
    free_.pop_back();
    clusters_[c] = {};
  }
  cluster_of_[first] = c;
  next_member_[first] = kNone;
  TetId last = first;
  std::uint32_t size = 1;
  for (TetId t = first; t != kNone && size < kMaxSize; t = next_member_[t]) {
    for (int f = 0; f < 4 && size < kMaxSize; ++f) {
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

void TetClusters::find_links(std::uint32_t cluster) {
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

void TetClusters::dissolve(std::uint32_t cluster, std::vector<TetId>& loose) {
  for (TetId t = clusters_[cluster].first; t != kNone; t = next_member_[t]) {
    cluster_of_[t] = kNone;
    if (mesh_.alive(t)) loose.push_back(t);
  }
  clusters_[cluster] = {};
  free_.push_back(cluster);
}

void TetClusters::archive(Archive& io) {
  std::vector<std::uint32_t> listed;
  if (!io.reads()) listed = list();
  io.list(listed, 4, [&](std::uint32_t& entry) { io(entry); });
  if (!io.reads() || io.failed()) return;
  io.demand(restore(listed), "clusters that are not the tetrahedra, each once");
  grow_to(cluster_of_, mesh_.tet_slots());
  grow_to(next_member_, mesh_.tet_slots());
}

std::vector<std::uint32_t> TetClusters::list() const {
  std::vector<std::uint32_t> listed;
  listed.reserve(mesh_.live_tets() + clusters_.size());
  // In the order of their first members: a restored session assigns other slots.
  for (TetId first = 0; first < cluster_of_.size(); ++first) {
    if (cluster_of_[first] == kNone || clusters_[cluster_of_[first]].first != first) continue;
    const Cluster& c = clusters_[cluster_of_[first]];
    listed.push_back(c.size | (c.links != kNone ? kLinked : 0));
    for (TetId t = c.first; t != kNone; t = next_member_[t]) listed.push_back(t);
  }
  return listed;
}

bool TetClusters::restore(std::span<const std::uint32_t> listed) {
  clusters_.clear();
  free_.clear();
  links_.clear();
  cluster_of_.assign(mesh_.tet_slots(), kNone);
  next_member_.assign(mesh_.tet_slots(), kNone);
  std::vector<std::uint32_t> linked;
  std::size_t members = 0;
  while (!listed.empty()) {
    const std::uint32_t size = listed[0] & ~kLinked;
    if (size == 0 || size > kMaxSize || size >= listed.size()) return false;
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
  // Links to clusters without links are kept as they were: they make searches use the faces.
  for (const std::uint32_t c : linked) find_links(c);
  return members == mesh_.live_tets();
}

}  // namespace incise::core
