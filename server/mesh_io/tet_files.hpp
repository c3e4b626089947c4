#pragma once

// Files of tetrahedra, except TetGen's (tetgen_files.hpp).

#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "server/mesh_io/field.hpp"
#include "server/mesh_io/surface.hpp"

namespace incise::mesh_io {

// Limits of core::TetMesh: half-faces and new ids fit in 32 bits.
inline constexpr std::size_t kMaxTets = (std::size_t{1} << 28) - 2;

// The parsers take a file's bytes, and its name for messages. They give the vertices in the file's order (all of them)
// and the tetrahedra; cells of fewer dimensions are skipped, tetrahedra of higher order keep their corners (a warning
// says so), other cells of three dimensions are an error: leaving them out would leave holes. Coordinates are finite and
// indices exist; repair_tets decides whether the mesh can be cut. `regions` is empty if the file has none. They
// throw MeshError. `fields`, if given, gets the file's fields, a row for each vertex and tetrahedron.

// Gmsh MSH 1, 2.x (ASCII, binary) and 4.1 (ASCII, binary). The region is the physical group of the volume; if the
// file has several volumes and no such group, the volume's number. A tetrahedron that the file repeats for each of its
// groups (MSH 2) is read once, with its first group. Fields: $NodeData and $ElementData.
core::MeshData parse_gmsh(std::string_view bytes, const std::string& file, std::vector<std::string>& warnings,
                          std::vector<Field>* fields = nullptr);
// Legacy VTK (2.0 to 5.1), ASCII or binary, UNSTRUCTURED_GRID. The region is the cell data that find_region_array finds.
core::MeshData parse_vtk(std::string_view bytes, const std::string& file, std::vector<std::string>& warnings,
                         std::vector<Field>* fields = nullptr);
// VTK XML UnstructuredGrid: arrays as text, base64, or appended (raw or base64), of either byte order, plain or
// compressed with zlib. Several pieces become one mesh. The region as for parse_vtk.
core::MeshData parse_vtu(std::string_view bytes, const std::string& file, std::vector<std::string>& warnings,
                         std::vector<Field>* fields = nullptr);
// Medit .mesh, ASCII. The region is the tetrahedron's reference; the vertices' references, where any is not 0, are the field
// "medit:ref".
core::MeshData parse_medit(std::string_view bytes, const std::string& file,
                           std::vector<std::string>& warnings, std::vector<Field>* fields = nullptr);
// VegaFEM .veg, which has no fields. The region is the number, from 0, of the material that the last *REGION assigns.
core::MeshData parse_vega(std::string_view bytes, const std::string& file, std::vector<std::string>& warnings,
                          std::vector<Field>* fields = nullptr);

// The index of the cell array with the regions: the first that exists of region, regions, gmsh:physical,
// PhysicalIds, MaterialIds, material, medit:ref, CellEntityIds, attribute; upper or lower case. -1: none.
int find_region_array(std::span<const std::string> names);
// How to read a VTK cell type. > 0: a tetrahedron with at least so many nodes, the first four its corners; 0: a cell of
// fewer dimensions, skipped; -1: another cell of three dimensions.
int vtk_tet_nodes(std::int64_t type);

// Legacy VTK 3.0, binary, with `cell_data` as scalars, fields as field data of points and cells, and `cut_memory`, where there is any, as field data.
void write_vtk_legacy(const std::filesystem::path& path, std::span<const core::Vec3> positions,
                      std::span<const std::array<core::VertexId, 4>> tets,
                      std::span<const CellArray> cell_data, std::span<const Field> fields = {},
                      std::span<const std::byte> cut_memory = {});
// Gmsh MSH, ASCII: version 2.2 or 4.1. Each region is a volume and, where it is not 0, its physical group (Gmsh reads a
// negative group as the positive one with its volume turned over).
void write_gmsh(const std::filesystem::path& path, std::span<const core::Vec3> positions,
                std::span<const std::array<core::VertexId, 4>> tets, std::span<const std::int32_t> regions,
                bool version_4);
// Medit .mesh, ASCII, regions as references.
void write_medit(const std::filesystem::path& path, std::span<const core::Vec3> positions,
                 std::span<const std::array<core::VertexId, 4>> tets, std::span<const std::int32_t> regions);

}  // namespace incise::mesh_io
