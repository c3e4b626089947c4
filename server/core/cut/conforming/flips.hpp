#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "server/core/cut/conforming/mesh_editor.hpp"

namespace incise::core {

// Replaces a poor tetrahedron and some around it by others between the same vertices (Freitag and Ollivier-Gooch 1997,
// "Tetrahedral mesh improvement using swapping and smoothing"): an edge of it is removed, or a face of it gives way to an
// edge. Whatever the swept surface separates later has to stay apart, so edges and faces on it stay; all that shares a
// vertex off the surface lies on one side of it. For a needle, edges and faces between vertices on the surface may go that are
// farther off it than kFlipOff_h: what crosses the surface then, verification finds.
class Flips {
 public:
  Flips(CutContext& cut, MeshEditor& editor) : cut_(cut), mesh_(cut.mesh), editor_(editor) {}

  // The new tetrahedra, all better than the worst that was there; none where no flip helps.
  std::span<const TetId> improve(TetId t);

 private:
  static constexpr std::size_t kMaxRing = tolerance::kMaxEdgeRing;

  std::span<const TetId> remove_edge(TetId t, VertexId a, VertexId b);
  bool has_to_stay(const Vec3& middle) const;
  bool order_ring(TetId t, VertexId a, VertexId b);
  bool triangulate(VertexId a, VertexId b);
  void fill(VertexId a, VertexId b, std::size_t i, std::size_t j);
  std::span<const TetId> remove_face(HalfFace h);

  CutContext& cut_;
  const TetMesh& mesh_;
  MeshEditor& editor_;
  bool is_needle_ = false;  // the tetrahedron to be replaced is worse than kSnapFloor
  // The edge that is removed: the tetrahedra around it, their vertices off it, so that (a, b, ring[i], ring[i + 1]) has one
  // orientation for all i, and the worst measure among them.
  std::vector<TetId> tets_;
  std::array<VertexId, kMaxRing> ring_{};
  double before_ = 0;
  // Of the best triangles for the ring's part from i to j, (i, apex[i][j], j) is one.
  std::size_t apex_[kMaxRing][kMaxRing];
  std::array<std::array<VertexId, 4>, 2 * (kMaxRing - 2)> added_;
  std::size_t added_count_ = 0;
};

}  // namespace incise::core
