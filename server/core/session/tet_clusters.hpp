#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// The tetrahedra of a mesh in connected clusters of some 32, and these in connected blocks of some 32 clusters, so that searches can
// pass a thousand tetrahedra at a time. When a step changes the neighbours of a tetrahedron, its cluster is dissolved and formed
// again, as one or several, and its block is given up: its clusters stand alone from then on. What no step has touched yet knows its
// neighbours (its links), so a search passes it at once.
class TetClusters {
 public:
  // What a search passes at once: a block, or a cluster that is in none. It lies wholly in one piece.
  struct Node {
    std::uint32_t tets = 0;
    std::uint32_t piece = 0;
    std::uint32_t search = 0, group = 0;  // for PieceTracker: the search that came by, and its group
  };
  using NodeId = std::uint32_t;
  // A tetrahedron without a cluster, and the piece that it is in.
  struct Loose {
    TetId tet;
    std::uint32_t piece;
  };

  // All in piece 0. O(mesh).
  explicit TetClusters(const TetMesh& mesh);
  // The same of a copy of that mesh. O(mesh).
  TetClusters(const TetMesh& copy, const TetClusters& other);
  TetClusters(const TetClusters&) = delete;
  TetClusters& operator=(const TetClusters&) = delete;

  // With the mesh. New tetrahedra are in no cluster.
  void grow();

  // Those of each cluster side by side, among some that are in none.
  std::span<const TetId> members() const { return members_; }

  // False: t is dead, or has no cluster yet.
  bool has(TetId t) const { return cluster_of_[t] != kNone; }
  // Of a tetrahedron that has a cluster.
  NodeId node_of(TetId t) const { return node_of_cluster(cluster_of_[t]); }
  Node& operator[](NodeId node) {
    return node & kBlock ? blocks_[node & ~kBlock].node : clusters_[node].node;
  }
  const Node& operator[](NodeId node) const {
    return node & kBlock ? blocks_[node & ~kBlock].node : clusters_[node].node;
  }
  // For a node that is visited soon.
  void prefetch_beside(NodeId node) const {
    if (node & kBlock) {
      __builtin_prefetch(block_links_.data() + blocks_[node & ~kBlock].links);
    } else if (clusters_[node].links != kNone) {
      __builtin_prefetch(links_.data() + clusters_[node].links);
    } else {
      __builtin_prefetch(members_.data() + clusters_[node].members);
    }
  }
  std::uint32_t piece(TetId t) const { return (*this)[node_of(t)].piece; }

  // The cluster of t is no more, nor is its block; its living tetrahedra are appended to `loose`. Returns units of work.
  std::int64_t dissolve(TetId t, std::vector<Loose>& loose);
  // A cluster of a tetrahedron that has none and others around it that have none, either. Returns units of work.
  std::int64_t form(const Loose& first);
  // Calls visit(node) for its neighbours, some more than once. Returns units of work.
  template <class Visit>
  std::int64_t visit_beside(NodeId node, Visit visit) const;

  // Which clusters and blocks there are, and their pieces; the mesh has been read.
  void archive(Archive& io, std::uint32_t pieces);

 private:
  // Larger clusters make searches faster, but more of the mesh dissolves along a cut. What is left between clusters and has less
  // than kFew joins one of them, up to kMax; the same goes for clusters between blocks.
  static constexpr std::uint32_t kFull = 32, kFew = 12, kMax = 64;
  // In a NodeId: of a block. In the list of all clusters: links are known.
  static constexpr std::uint32_t kBlock = 1u << 31, kLinked = 1u << 31;

  struct Cluster {
    Node node;                                   // of no tetrahedra: the slot is free
    std::uint32_t members = 0;                   // where in members_
    std::uint32_t room = 0;                      // for so many, also while the slot is free
    std::uint32_t links = kNone, links_end = 0;  // kNone: some step has touched it
    std::uint32_t block = kNone;
    std::uint32_t next_in_block = kNone;
  };
  struct Block {
    Node node;
    std::uint32_t first = kNone;  // cluster; kNone: it has been given up
    std::uint32_t links = 0, links_end = 0;
    bool all_linked = false;  // links has all neighbours: all of them were blocks
  };

  NodeId node_of_cluster(std::uint32_t c) const {
    return clusters_[c].block == kNone ? c : clusters_[c].block | kBlock;
  }
  template <class Visit>
  std::int64_t visit_beside_cluster(std::uint32_t cluster, Visit visit) const;
  std::span<const TetId> members_of(const Cluster& c) const {
    return {members_.data() + c.members, c.node.tets};
  }
  void free(std::uint32_t cluster);
  void pack_members();
  void take_room(Cluster& c, std::uint32_t count);
  bool join_cluster(std::uint32_t cluster);
  bool join_block(std::uint32_t block, std::uint32_t last);
  void find_links(std::uint32_t cluster);
  void form_blocks();
  std::uint32_t begin_block(std::uint32_t cluster);
  void find_block_links(std::uint32_t block);
  std::vector<std::uint32_t> list() const;
  // False, and unusable from then on, if they are not the living tetrahedra, each once.
  bool restore(std::span<const std::uint32_t> listed, std::uint32_t pieces);

  const TetMesh& mesh_;
  std::vector<std::uint32_t> cluster_of_;  // by tetrahedron
  std::vector<TetId> members_;             // of each cluster side by side: what comes next is fetched
  std::vector<Cluster> clusters_;
  std::vector<std::uint32_t> free_;
  std::vector<Block> blocks_;
  // Clusters that share a face with one, and blocks that do with one. A cluster that has been formed again has no links itself.
  std::vector<std::uint32_t> links_, block_links_;
};

template <class Visit>
std::int64_t TetClusters::visit_beside(NodeId node, Visit visit) const {
  if (!(node & kBlock)) return visit_beside_cluster(node, visit);
  const Block& b = blocks_[node & ~kBlock];
  bool all_known = b.all_linked;
  for (std::uint32_t l = b.links; l != b.links_end; ++l) {
    if (blocks_[block_links_[l]].first == kNone) {
      all_known = false;
    } else {
      visit(block_links_[l] | kBlock);
    }
  }
  if (all_known) return 2;
  // Where a block beside it was given up, its clusters are found through the clusters here.
  std::int64_t units = 2;
  for (std::uint32_t c = b.first; c != kNone; c = clusters_[c].next_in_block)
    units += visit_beside_cluster(c, visit);
  return units;
}

template <class Visit>
std::int64_t TetClusters::visit_beside_cluster(std::uint32_t cluster, Visit visit) const {
  const Cluster& c = clusters_[cluster];
  bool all_known = c.links != kNone;
  if (all_known) {
    for (std::uint32_t l = c.links; l != c.links_end; ++l) {
      // If a neighbour was formed again, its new clusters are found through the faces only.
      if (clusters_[links_[l]].links == kNone) {
        all_known = false;
      } else {
        visit(node_of_cluster(links_[l]));
      }
    }
  }
  if (all_known) return 2;
  // First collect all neighbours, without branches: most of the time goes into waiting for memory.
  std::uint32_t beside[4 * kMax];
  std::size_t count = 0;
  const std::uint32_t* const cluster_of = cluster_of_.data();
  for (const TetId t : members_of(c)) mesh_.prefetch(t);
  for (const TetId t : members_of(c)) {
    for (int f = 0; f < 4; ++f) {
      const TetId n = mesh_.neighbor(t, f);
      beside[count] = cluster_of[n == kNone ? t : n];
      count += beside[count] != cluster;
    }
  }
  for (std::size_t i = 0; i < count; ++i) __builtin_prefetch(&clusters_[beside[i]]);
  const std::int64_t units = 1 + c.node.tets / 4;
  std::uint32_t met = cluster;
  for (std::size_t i = 0; i < count; ++i) {
    if (beside[i] == met) continue;
    met = beside[i];
    visit(node_of_cluster(met));
  }
  return units;
}

}  // namespace incise::core
