#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"

namespace incise::mesh_io {

struct Material {
  std::string name;
  std::array<float, 3> diffuse{0.8f, 0.8f, 0.8f};  // red, green, blue of sRGB, 0 to 1
  std::shared_ptr<const std::string> image;        // the bytes of its texture; null: none
  std::string image_type;                          // as in HTTP: "image/png"
  float roughness = 0.45f;                         // 0 wet, 1 dry; written, not read
};

// What a surface looks like. Arrays by corner have three entries a triangle, in the order of its vertices, so they may differ on both sides of
// an edge: seams. What the file does not have is empty.
struct SurfaceLook {
  std::vector<std::array<float, 2>> uvs;  // texture coordinates, v upwards
  std::vector<std::array<float, 3>> normals;
  std::vector<std::array<std::uint8_t, 4>> colours;  // red, green, blue, alpha
  std::vector<std::uint32_t> material_of;            // by triangle: into materials
  std::vector<Material> materials;

  // Adds an entry for each corner of the fan that add_polygon() makes of a polygon with these values at its corners.
  template <class T>
  static void add_fan(std::vector<T>& values, const std::vector<T>& corners) {
    for (std::size_t i = 2; i < corners.size(); ++i)
      values.insert(values.end(), {corners[0], corners[i - 1], corners[i]});
  }
};

// A triangulated surface; triangles are counter-clockwise seen from outside.
struct Surface {
  std::vector<core::Vec3> positions;  // metres
  std::vector<std::array<core::VertexId, 3>> triangles;
  SurfaceLook look = {};
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
