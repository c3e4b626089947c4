#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "server/core/geometry/vec3.hpp"

namespace incise::core {

using VertexId = std::uint32_t;
using TetId = std::uint32_t;
inline constexpr std::uint32_t kNone = 0xffffffffu;

// A tetrahedral mesh as plain arrays: what the readers make, what the writers take, what a TetMesh is built from.
struct MeshData {
  std::vector<Vec3> positions;                // metres
  std::vector<std::array<VertexId, 4>> tets;  // (v1-v0)x(v2-v0).(v3-v0) > 0
  std::vector<std::int32_t> regions;          // material id of each tetrahedron; empty: all 0
};

}  // namespace incise::core
