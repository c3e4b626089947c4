#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// The tetrahedra of a mesh in connected clusters of up to 32, so that searches can pass a cluster at a time. When a step changes
// the neighbours of a tetrahedron, its cluster is dissolved and formed again, as one or several. A cluster that no step has touched
// yet knows its neighbour clusters (its links), so a search passes it at once.
class TetClusters {
 public:
  struct Cluster {
    TetId first = kNone;  // member; kNone: the slot is free
    std::uint32_t size = 0;
    std::uint32_t links = kNone, links_end = kNone;  // kNone: some step has touched it
    std::uint32_t search = 0, group = 0;  // for PieceTracker: the search that came by, and its group
  };

  // O(mesh).
  explicit TetClusters(const TetMesh& mesh);

  // With the mesh. New tetrahedra are in none.
  void grow();

  // kNone: t is dead, or has no cluster yet.
  std::uint32_t of(TetId t) const { return cluster_of_[t]; }
  // The member after t; kNone after the last.
  TetId next_member(TetId t) const { return next_member_[t]; }
  Cluster& operator[](std::uint32_t cluster) { return clusters_[cluster]; }
  const Cluster& operator[](std::uint32_t cluster) const { return clusters_[cluster]; }

  // Its living members are appended to `loose`.
  void dissolve(std::uint32_t cluster, std::vector<TetId>& loose);
  // A cluster of `first` and tetrahedra around it that have none.
  void form(TetId first);
  // Calls visit(cluster) for its neighbours, some more than once. Returns units of work.
  template <class Visit>
  std::int64_t visit_beside(std::uint32_t cluster, Visit visit) const;

  // Which clusters there are; the mesh has been read.
  void archive(Archive& io);

 private:
  // Larger clusters make searches faster, but more of the mesh dissolves along a cut.
  static constexpr std::size_t kMaxSize = 32;
  // In the list of all clusters: the size, and this bit where links are known, then the members.
  static constexpr std::uint32_t kLinked = 1u << 31;

  void find_links(std::uint32_t cluster);
  std::vector<std::uint32_t> list() const;
  // False, and unusable from then on, if they are not the living tetrahedra, each once.
  bool restore(std::span<const std::uint32_t> listed);

  const TetMesh& mesh_;
  std::vector<std::uint32_t> cluster_of_;  // by tetrahedron
  std::vector<TetId> next_member_;         // by tetrahedron
  std::vector<Cluster> clusters_;
  std::vector<std::uint32_t> free_;
  // Clusters that share a face with one; a slot that has been formed again has no links itself.
  std::vector<std::uint32_t> links_;
};

template <class Visit>
std::int64_t TetClusters::visit_beside(std::uint32_t cluster, Visit visit) const {
  const Cluster& c = clusters_[cluster];
  bool all_known = c.links != kNone;
  for (std::uint32_t l = c.links; l != c.links_end; ++l) {
    // If a neighbour was formed again, its new clusters are found through the faces only.
    if (clusters_[links_[l]].links == kNone) {
      all_known = false;
    } else {
      visit(links_[l]);
    }
  }
  if (all_known) return 2;
  // First collect all neighbours, without branches: most of the time goes into waiting for memory.
  std::uint32_t beside[4 * kMaxSize];
  std::size_t count = 0;
  for (TetId t = c.first; t != kNone; t = next_member_[t]) {
    for (int f = 0; f < 4; ++f) {
      const TetId n = mesh_.neighbor(t, f);
      beside[count] = cluster_of_[n == kNone ? t : n];
      count += beside[count] != cluster;
    }
  }
  const std::int64_t units = 1 + c.size / 4;
  std::uint32_t met = cluster;
  for (std::size_t i = 0; i < count; ++i) {
    if (beside[i] == met) continue;
    met = beside[i];
    visit(met);
  }
  return units;
}

}  // namespace incise::core
