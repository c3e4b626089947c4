#pragma once

#include <array>
#include <cstddef>
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
  // Of each tetrahedron, bit f: an earlier cut opened face f, which is on the boundary (elsewhere it means nothing). Empty: none. What a stroke joins to a
  // cut, it joins to such faces, too.
  std::vector<std::uint8_t> cut_masks = {};
  // What blades have left in it beside these cuts, as CutSession::export_data() gives it (cut_memory.hpp). Empty: not known. Where points or
  // tetrahedra are others than it was saved with, it means nothing.
  std::vector<std::byte> cut_memory = {};
  // What lies behind each face: entry 4 t + f is 4 n + g where face f of t is face g of n, kNone on the boundary. Readers that have found
  // this out leave it here where the tetrahedra at each vertex hang together through faces, which saves TetMesh a third of its time. Empty:
  // not known. Whoever changes `tets` clears it.
  std::vector<std::uint32_t> opposite = {};
};

}  // namespace incise::core
