#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"

namespace incise::mesh_io {

// Prepares a mesh from a file for cutting, or says why that is impossible:
// - reverses left-handed tetrahedra: orientation is made consistent over shared faces, then right-handed by the majority of
//   each body;
// - fixes tetrahedra that are still inverted or flat: moves a vertex a little if that makes its whole star positive, else
//   removes the tetrahedron if it has a boundary face;
// - drops vertices that no tetrahedron uses.
// Each of these, and each tolerated flaw (vertices whose star is not face-connected, which the core splits; coincident
// vertices), adds a line to `warnings` that names the first.
//
// Throws MeshError, in the file's own indices (`index_base` added), if an index is out of range, a coordinate is not finite
// or too large for exact predicates, a tetrahedron repeats a vertex, two have the same vertices, more than two share a
// face, or an inverted one can be neither fixed nor removed. O(n log n).
//
// `kept`, if given: which of the vertices and tetrahedra of before are left, in their order.
struct KeptElements {
  std::vector<std::uint32_t> vertices, tets;
};
void repair_tets(core::MeshData& mesh, const std::string& file, int index_base,
                 std::vector<std::string>& warnings, KeptElements* kept = nullptr);

}  // namespace incise::mesh_io
