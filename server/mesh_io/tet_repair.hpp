#pragma once

#include <string>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"

namespace incise::mesh_io {

// Makes a mesh as a file has it into one that can be cut, or says why that cannot be:
// - turns left-handed tetrahedra (whole bodies, or single ones among others: orientation is made consistent
// over
//   shared faces, then right-handed by the majority of each body);
// - mends tetrahedra that are inverted or flat in truth: moves a vertex a little where that makes its whole
// star
//   positive, else removes the tetrahedron where it has a boundary face;
// - drops vertices that no tetrahedron has.
// Each of these, and what is tolerated (vertices whose star is not face-connected: the core splits them;
// coincident vertices), adds a line to `warnings` that names the first.
//
// Throws MeshError, in the file's own indices (`index_base` added), where an index is out of range, a
// coordinate is not finite or beyond what exact predicates take, a tetrahedron repeats a vertex, two have the
// same vertices, more than two share a face, or an inverted one can be neither mended nor removed. O(n log
// n).
void repair_tets(core::MeshData& mesh, const std::string& file, int index_base,
                 std::vector<std::string>& warnings);

}  // namespace incise::mesh_io
