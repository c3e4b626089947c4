#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <vector>

#include "server/app/config.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/mesh_io/surface.hpp"

namespace incise::app {

// What a region of the mesh is drawn with. An image is put on by place, in squares of 5 cm.
struct RegionMaterials {
  std::int32_t region = 0;
  mesh_io::Material surface, inside;
};
// Of each region, ascending, as viewers show it (look.hpp), without its pattern; empty where that is left to them. `file`: the configuration in
// messages. Throws ConfigError for a texture that cannot be used.
std::vector<RegionMaterials> region_materials(const Config& config, const core::MeshData& mesh,
                                              const std::string& file);

// The boundary of a cut mesh with what it looks like. Arrays have an entry for each triangle.
struct CutSurface {
  mesh_io::Surface
      surface;  // metres; its look: texture coordinates and colours by corner, materials, those of `from` first
  std::vector<std::uint32_t>
      origins;  // triangle of the surface that the body was filled from; kNone: none, as a cut face
  std::vector<std::uint8_t> cut;      // 1: a cut face
  std::vector<std::uint32_t> pieces;  // as given to cut_surface()
};
// `from`: the surface that the body was filled from, or null; where it has an image, or colours, these are seen. Else the skin has its region's material, and
// the inside always. Without `regions` it has two materials, "outside" (or that of `from`) and "inside". Vertices ascend by id, triangles are those of
// boundary_surface(), but split along seams of the texture. `pieces`: core::piece_numbers(). O(mesh log surface).
CutSurface cut_surface(const core::TetMesh& mesh, const std::vector<std::uint32_t>& pieces,
                       const mesh_io::Surface* from, const std::vector<RegionMaterials>& regions);

// The origin of each face of each live tetrahedron, ascending by id: four entries each, face f opposite to vertex f; kNone: it is within the body, or a
// cut face. O(mesh log surface).
std::vector<std::array<std::uint32_t, 4>> face_origins(const core::TetMesh& mesh,
                                                       const mesh_io::Surface& from);

// Texture coordinates of the corners of each boundary face, ascending by half-face: NaN for a cut face, and where the surface has none. O(mesh log surface).
std::vector<std::array<std::array<float, 2>, 3>> face_uvs(const core::TetMesh& mesh,
                                                          const mesh_io::Surface& from);

// Writes it as binary glTF 2.0: a node piece_N for each piece N with a primitive for each material, the images that are used, normals smooth but for creases and the rims of
// cuts, texture coordinates. Metres; the root turns z upwards to y. Throws MeshError.
void write_glb(const std::filesystem::path& path, const CutSurface& cut);

}  // namespace incise::app
