#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"

namespace incise::oracle {

enum class End : std::uint8_t { kNone, kOne, kOther };

// The fewest faces whose opening parts the tetrahedra at one end from those at the other (minimum cut: Ford and Fulkerson 1956), as seen from the first
// end; none where they hang together by more than `most`. `ends`: by tetrahedron. Takes a walk through the mesh for each face.
std::vector<core::HalfFace> fewest_faces_between(const core::TetMesh& mesh, std::span<const End> ends,
                                                 std::size_t most);

}  // namespace incise::oracle
