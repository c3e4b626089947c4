#pragma once

#include <cstddef>

#include "server/core/mesh/tet_mesh.hpp"

namespace incise::core {

// Calls visit(v) for `count` of the mesh's vertices at most, evenly spread over their numbers. O(count).
template <class Visit>
void each_vertex_sample(const TetMesh& mesh, std::size_t count, Visit visit) {
  const std::size_t stride = 1 + mesh.vertex_slots() / count;
  for (std::size_t i = 0; i < mesh.vertex_slots(); i += stride) {
    const auto v = static_cast<VertexId>(i);
    if (mesh.is_used(v)) visit(v);
  }
}

}  // namespace incise::core
