#pragma once

#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"

namespace incise::core {

// How a face inside the tissue lies among the boundary and older cuts, by its edges.
class HoleFinder {
 public:
  explicit HoleFinder(CutContext& cut) : cut_(cut), mesh_(cut.mesh) {}

  // How many of a face's edges are at the boundary. `continues` becomes true where a cut goes on beyond one of them.
  int edges_at_boundary(HalfFace h, bool& continues);
  // Whether an older cut has left a face where it ends at another one.
  bool is_hole(HalfFace h);

 private:
  bool ends_at_boundary(HalfFace h, VertexId a, VertexId b, bool& continues);
  HalfFace face_beyond(HalfFace h, VertexId a, VertexId b) const;
  bool lies_at_cut(HalfFace h);
  bool is_beyond(HalfFace other, HalfFace h, VertexId a, VertexId b) const;
  bool lies_beyond(HalfFace other, HalfFace h, VertexId a, VertexId b) const;

  CutContext& cut_;
  const TetMesh& mesh_;
  std::vector<TetId> ring_;  // of face_beyond() as well: the last edge's
};

}  // namespace incise::core
