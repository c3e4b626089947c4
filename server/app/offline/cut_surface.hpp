#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"
#include "server/mesh_io/surface.hpp"

namespace incise::app {

// The boundary of a cut mesh with what it looks like. Arrays have an entry for each triangle.
struct CutSurface {
  mesh_io::Surface
      surface;  // metres; its look: texture coordinates and colours by corner, materials, of which "inside" is the last
  std::vector<std::uint32_t>
      origins;  // triangle of the surface that the body was filled from; kNone: none, as a cut face
  std::vector<std::uint8_t> cut;      // 1: a cut face
  std::vector<std::uint32_t> pieces;  // numbered by lowest tetrahedron
};
// `from`: the surface that the body was filled from; null: it has one material, "outside", beside the inside. Vertices ascend by id, triangles are those of
// boundary_surface(). O(mesh log surface).
CutSurface cut_surface(const core::TetMesh& mesh, const mesh_io::Surface* from);

// The origin of each face of each live tetrahedron, ascending by id: four entries each, face f opposite to vertex f; kNone: it is within the body, or a
// cut face. O(mesh log surface).
std::vector<std::array<std::uint32_t, 4>> face_origins(const core::TetMesh& mesh,
                                                       const mesh_io::Surface& from);

// Texture coordinates of the corners of each boundary face, ascending by half-face: NaN for a cut face, and where the surface has none. O(mesh log surface).
std::vector<std::array<std::array<float, 2>, 3>> face_uvs(const core::TetMesh& mesh,
                                                          const mesh_io::Surface& from);

// Writes it as binary glTF 2.0: a node for each piece with a primitive for each material, images embedded, normals smooth but for creases and the rims of
// cuts, texture coordinates. Metres; the root turns z upwards to y. Throws MeshError.
void write_glb(const std::filesystem::path& path, const CutSurface& cut);

}  // namespace incise::app
