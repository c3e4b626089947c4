#pragma once

#include <array>
#include <filesystem>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"

namespace incise::mesh_io {

// A triangulated surface; triangles are counter-clockwise seen from outside.
struct Surface {
  std::vector<core::Vec3> positions;  // metres
  std::vector<std::array<core::VertexId, 3>> triangles;
};

// A named value for each cell (tetrahedron or triangle) that is written.
struct CellArray {
  std::string name;
  std::variant<std::vector<std::uint8_t>, std::vector<std::int32_t>, std::vector<std::uint32_t>,
               std::vector<float>, std::vector<double>>
      values;
};

// The volume that a closed surface encloses, m^3; negative if it is inside out.
double signed_volume(const Surface& surface);

// The boundary of a mesh: the faces of only one tetrahedron, counter-clockwise from outside, vertices
// renumbered in ascending order. `half_faces`, if given, gets 4 * tetrahedron + face of each triangle.
// O(n).
Surface boundary_surface(std::span<const core::Vec3> positions,
                         std::span<const std::array<core::VertexId, 4>> tets,
                         std::vector<std::uint32_t>* half_faces = nullptr);

}  // namespace incise::mesh_io
