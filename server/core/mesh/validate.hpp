#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "server/core/mesh/tet_mesh.hpp"

namespace incise::core {

// Checks what a TetMesh promises: adjacency symmetric and over the same three vertices, every vertex star
// face-connected, cut faces on the boundary, the state hash right. Returns an empty string, or the first violation
// with its ids. `orientation` also demands that every tetrahedron is positively oriented (exactly). O(mesh).
std::string validate(const TetMesh& mesh, bool orientation = true);

// The same for some tetrahedra and the stars of their vertices only, without the hash. O(sum of stars).
std::string validate_near(const TetMesh& mesh, std::span<const TetId> tets, bool orientation = true);

}  // namespace incise::core
