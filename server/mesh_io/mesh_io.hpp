#pragma once

// Mesh files in and out: what server/app and the tests use. A file's ending says what it is.

#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"
#include "server/mesh_io/field.hpp"
#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/surface.hpp"
#include "server/mesh_io/tetgen_fill.hpp"

namespace incise::mesh_io {

struct LoadOptions {
  double scale_to_metres = 1;  // the file's coordinates times this are metres; > 0 and finite
  FillOptions fill;            // how a surface is filled with tetrahedra; unused for a tetrahedral mesh
  bool fields = false;         // read the fields of a tetrahedral mesh, too
};

struct LoadedMesh {
  core::MeshData mesh;                // valid for core::TetMesh: every tetrahedron positive
  std::vector<Field> fields;          // one row for each vertex or tetrahedron of `mesh`
  std::vector<std::string> warnings;  // one line each: what was repaired or tolerated, and the first place
  std::string content_hash;           // of `mesh`: 64 hexadecimal digits (mesh_hash); hash() sets it
  bool filled = false;                // from a surface
  // That surface, where a file has it: scaled, its triangles turned outwards, else as in the file.
  std::shared_ptr<const Surface> surface;
  bool from_cache = false;  // and the fill came from the cache

  void hash();
  // Whether a capture names this mesh. Those of earlier versions may hold another hash of one without regions: a TetGen file's zeros counted.
  bool has_hash(const std::string& recorded) const {
    return recorded == content_hash || (!zeros_hash_.empty() && recorded == zeros_hash_);
  }

 private:
  std::string zeros_hash_;  // empty: the mesh has regions
};

// Reads a tetrahedral mesh (.node, .ele, or the base name of both; Gmsh .msh, VTK .vtk and .vtu, Medit .mesh, VegaFEM
// .veg: see tet_files.hpp) or a closed surface (.stl, .ply, .off, .obj,
// .glb), which is checked and filled by TetGen in a child process. The mesh is scaled, checked and repaired
// (repair_tets). Throws MeshError.
LoadedMesh load_mesh(const std::filesystem::path& path, const LoadOptions& options = {});

// load_mesh(), but without filling a surface: of that the mesh has the vertices, no tetrahedra, and its regions once each.
LoadedMesh check_mesh(const std::filesystem::path& path, const LoadOptions& options = {});

// Reads a triangle surface by its ending, in the file's units, unchecked (check_surface in
// surface_check.hpp).
Surface read_surface(const std::filesystem::path& path, std::vector<std::string>& warnings);

// SHA-256, as 64 hexadecimal digits, of the counts, coordinates, tetrahedra and regions: two meshes with the
// same hash are the same bits. Regions that are all 0 are as none, which is how most formats have them.
std::string mesh_hash(const core::MeshData& mesh);

// Whether load_mesh reads a file with this ending as tetrahedra.
bool is_mesh_input(const std::filesystem::path& path);
// Whether load_mesh reads one as a surface to fill, or says why not.
bool is_surface_input(const std::filesystem::path& path);
// Whether write_mesh / write_surface can write a file with this ending.
bool is_mesh_file(const std::filesystem::path& path);
bool is_surface_file(const std::filesystem::path& path);
// ".vtu, .node, .ele" and so on, for messages and --help.
std::string_view mesh_file_endings();
std::string_view surface_file_endings();
std::string_view surface_input_endings();  // of those that are read

// Writes a tetrahedral mesh by the ending of `path`: .vtu and .vtk with all of `cell_data` and `fields`, and `cut_memory` (MeshData's); with the array named
// "region" .node and .ele (as the attribute), .msh (Gmsh 4.1) and .msh2 (Gmsh 2.2; as the physical group), .mesh (as
// the reference). Each array has one value a tetrahedron. Throws MeshError.
void write_mesh(const std::filesystem::path& path, std::span<const core::Vec3> positions,
                std::span<const std::array<core::VertexId, 4>> tets,
                std::span<const CellArray> cell_data = {}, std::span<const Field> fields = {},
                std::span<const std::byte> cut_memory = {});
// The same for a mesh as loaded: positions, tetrahedra, regions, older cuts.
void write_mesh(const std::filesystem::path& path, const core::MeshData& mesh,
                std::span<const Field> fields = {});

// Writes a surface by the ending of `path`: .vtp and .ply with all of `cell_data`, one value a triangle; .stl
// (binary, float32), .off and .obj without; .obj with texture coordinates and, faces in their order, materials, which go into a .mtl beside it with their
// images. Throws MeshError, also where that would overwrite a .mtl or image that is not of its own making.
void write_surface(const std::filesystem::path& path, const Surface& surface,
                   std::span<const CellArray> cell_data = {});
// Throws MeshError if the .mtl beside this .obj is there and was not written by write_surface().
void require_own_materials(const std::filesystem::path& obj);

}  // namespace incise::mesh_io
