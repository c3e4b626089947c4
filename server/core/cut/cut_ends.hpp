#pragma once

#include "server/core/cut/swept_memory.hpp"
#include "server/core/mesh/tet_mesh.hpp"

namespace incise::core {

// Where the cuts that a body comes with end inside it, a face of the cut at each edge there, is remembered as if it had been swept: a
// later sweep that comes near leads it on. O(n log n) in the faces that cuts have opened.
void remember_cut_ends(const TetMesh& mesh, SweptMemory& swept);

}  // namespace incise::core
