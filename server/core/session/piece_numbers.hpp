#pragma once

#include <cstdint>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"

namespace incise::core {

class CutSession;

// The piece of each tetrahedron slot, kNone where the slot is empty: a number for each part that hangs together through faces, the same in every
// file and array that a state is written to. It is the session's id of the piece (Delta::pieces). That is one id for all parts that the body came with and
// no cut has touched yet, piece 0: the part with the most tetrahedra keeps the id, the first one of several as large, and the others are numbered behind the
// highest id there is, by their lowest tetrahedron. O(mesh).
std::vector<std::uint32_t> piece_numbers(const CutSession& session);
// Of a body as it is loaded: a session's at revision 0.
std::vector<std::uint32_t> piece_numbers(const TetMesh& mesh);

}  // namespace incise::core
