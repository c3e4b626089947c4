#include "server/mesh_io/mesh_io.hpp"

#include <algorithm>
#include <cmath>

#include "server/core/cut/cut_memory.hpp"
#include "server/mesh_io/hash.hpp"
#include "server/mesh_io/surface_check.hpp"
#include "server/mesh_io/surface_files.hpp"
#include "server/mesh_io/tet_files.hpp"
#include "server/mesh_io/tet_repair.hpp"
#include "server/mesh_io/tetgen_files.hpp"
#include "server/mesh_io/text_file.hpp"
#include "server/mesh_io/write_vtk.hpp"

namespace incise::mesh_io {
namespace {

std::string lowercase_ending(const std::filesystem::path& path) {
  return lowercase(path.extension().string());
}

bool is_one_of(std::string_view ending, std::initializer_list<std::string_view> endings) {
  return std::find(endings.begin(), endings.end(), ending) != endings.end();
}

// False, not an exception, if a directory on the path cannot be read.
bool is_there(const std::filesystem::path& path) {
  std::error_code error;
  return std::filesystem::exists(path, error);
}

using Parser = core::MeshData (*)(std::string_view, const std::string&, std::vector<std::string>&,
                                  std::vector<Field>*);

// The parser for files of tetrahedra, except TetGen's pair. Null: not one of these endings.
Parser parser_of(std::string_view ending) {
  static constexpr std::pair<std::string_view, Parser> kParsers[] = {
      {".msh", parse_gmsh}, {".msh2", parse_gmsh},  {".vtk", parse_vtk},
      {".vtu", parse_vtu},  {".mesh", parse_medit}, {".veg", parse_vega}};
  for (const auto& [known, parser] : kParsers) {
    if (ending == known) return parser;
  }
  return nullptr;
}

// The cell array named "region", as integers; empty without one.
std::vector<std::int32_t> regions_in(std::span<const CellArray> cell_data) {
  std::vector<std::int32_t> regions;
  for (const CellArray& array : cell_data) {
    if (array.name != "region") continue;
    std::visit(
        [&regions](const auto& values) {
          for (const auto value : values) regions.push_back(static_cast<std::int32_t>(value));
        },
        array.values);
  }
  return regions;
}

void scale(std::vector<core::Vec3>& positions, double factor) {
  if (factor == 1) return;
  for (core::Vec3& p : positions) p = factor * p;
}

}  // namespace

std::string_view mesh_file_endings() {
  return ".vtu, .vtk, .msh, .msh2, .mesh, .node, .ele";
}
std::string_view surface_file_endings() {
  return ".stl, .ply, .off, .obj, .vtp";
}
std::string_view surface_input_endings() {
  return ".stl, .ply, .off, .obj, .glb";
}
bool is_mesh_input(const std::filesystem::path& path) {
  const std::string ending = lowercase_ending(path);
  return is_one_of(ending, {".node", ".ele"}) || parser_of(ending) != nullptr;
}
bool is_mesh_file(const std::filesystem::path& path) {
  return is_one_of(lowercase_ending(path), {".vtu", ".vtk", ".msh", ".msh2", ".mesh", ".node", ".ele"});
}
bool is_surface_input(const std::filesystem::path& path) {
  // A .gltf is not read, but the reader of .glb says what to do with one.
  return is_one_of(lowercase_ending(path), {".stl", ".ply", ".off", ".obj", ".glb", ".gltf"});
}
bool is_surface_file(const std::filesystem::path& path) {
  return is_one_of(lowercase_ending(path), {".stl", ".ply", ".off", ".obj", ".vtp"});
}

namespace {

ClosedSurface read_closed_surface(const std::filesystem::path& path, const LoadOptions& options,
                                  std::vector<std::string>& warnings) {
  Surface surface = read_surface(path, warnings);
  scale(surface.positions, options.scale_to_metres);
  return check_surface(std::move(surface), path.string(), warnings);
}

}  // namespace

LoadedMesh check_mesh(const std::filesystem::path& path, const LoadOptions& options) {
  if (!is_surface_input(path)) return load_mesh(path, options);
  LoadedMesh checked;
  ClosedSurface closed = read_closed_surface(path, options, checked.warnings);
  checked.mesh.positions = std::move(closed.surface.positions);
  for (const ClosedSurface::Region& region : closed.regions) checked.mesh.regions.push_back(region.id);
  return checked;
}

LoadedMesh load_mesh(const std::filesystem::path& path, const LoadOptions& options) {
  if (!std::isfinite(options.scale_to_metres) || options.scale_to_metres <= 0) {
    throw MeshError(path.string() + ": the scale to metres is " + to_text(options.scale_to_metres) +
                    "; a positive number is accepted");
  }
  LoadedMesh loaded;
  std::string file = path.string();
  int index_base = 0;
  const std::string ending = lowercase_ending(path);
  if (is_surface_input(path)) {
    ClosedSurface closed = read_closed_surface(path, options, loaded.warnings);
    Fill fill = fill_surface(closed, file, options.fill, loaded.warnings);
    loaded.surface = std::make_shared<const Surface>(std::move(closed.surface));
    loaded.mesh = std::move(fill.mesh);
    loaded.filled = true;
    loaded.from_cache = fill.from_cache;
    file += " (filled)";
  } else if (const Parser parse = parser_of(ending)) {
    loaded.mesh =
        parse(read_whole_file(path), file, loaded.warnings, options.fields ? &loaded.fields : nullptr);
    scale(loaded.mesh.positions, options.scale_to_metres);
  } else if (is_one_of(ending, {".node", ".ele"}) || is_there(tetgen_paths(path).node)) {
    loaded.mesh = read_tetgen(path, index_base, loaded.warnings);
    scale(loaded.mesh.positions, options.scale_to_metres);
    file = tetgen_paths(path).ele.string();
  } else if (!is_there(path)) {
    throw MeshError(file + ": no such file" + (ending.empty() ? ", nor is there " + file + ".node" : ""));
  } else if (std::filesystem::is_directory(path)) {
    throw MeshError(file + ": is a directory; accepted is a mesh file");
  } else {
    throw MeshError(
        file + ": cannot read a mesh from " +
        (ending.empty() ? "a file without an ending" : "'" + ending + "'") +
        "; tetrahedra can be .node and .ele (or their common name), .msh, .vtk, .vtu, .mesh or .veg, "
        "a surface to fill .stl, .ply, .off, .obj or .glb");
  }
  const std::size_t vertices = loaded.mesh.positions.size(), tets = loaded.mesh.tets.size();
  KeptElements kept;
  repair_tets(loaded.mesh, file, index_base, loaded.warnings, loaded.fields.empty() ? nullptr : &kept);
  for (Field& field : loaded.fields) {
    const bool of_vertices = field.on == Field::On::kVertices;
    const auto& rows = of_vertices ? kept.vertices : kept.tets;
    if (rows.size() != (of_vertices ? vertices : tets)) field = rows_of(field, rows);
  }
  if (!loaded.mesh.cut_memory.empty() && !core::has_its_cut_memory(loaded.mesh)) {
    loaded.mesh.cut_memory.clear();
    loaded.warnings.push_back(file +
                              ": the mesh has been changed since it was saved with its cuts: they are kept, "
                              "but not where the blades that made them have been");
  }
  loaded.hash();
  return loaded;
}

Surface read_surface(const std::filesystem::path& path, std::vector<std::string>& warnings) {
  const std::string ending = lowercase_ending(path);
  if (ending == ".stl") return read_stl(path, warnings);
  if (ending == ".ply") return read_ply(path, warnings);
  if (ending == ".off") return read_off(path);
  if (ending == ".obj") return read_obj(path, warnings);
  if (ending == ".glb" || ending == ".gltf") return read_glb(path, warnings);
  throw MeshError(path.string() + ": cannot read a surface from " + (ending.empty() ? "it" : ending) +
                  "; save it as .stl, .ply, .off, .obj or .glb");
}

namespace {

bool has_regions(const core::MeshData& mesh) {
  return std::ranges::any_of(mesh.regions, [](std::int32_t region) { return region != 0; });
}

// What nearly all of the time goes to.
ContentHash hash_of_shape(const core::MeshData& mesh) {
  ContentHash hash;
  hash.add(mesh.positions);
  hash.add(mesh.tets);
  return hash;
}

std::string hash_with(const std::vector<std::int32_t>& regions, const core::MeshData& mesh,
                      ContentHash hash) {
  hash.add(regions);
  // So that all others keep their hash.
  if (!mesh.cut_masks.empty()) hash.add(mesh.cut_masks);
  if (!mesh.cut_memory.empty()) hash.add(mesh.cut_memory);
  return hash.hex();
}

}  // namespace

std::string mesh_hash(const core::MeshData& mesh) {
  return hash_with(has_regions(mesh) ? mesh.regions : std::vector<std::int32_t>{}, mesh, hash_of_shape(mesh));
}

void LoadedMesh::hash() {
  const ContentHash shape = hash_of_shape(mesh);
  const bool regions = has_regions(mesh);
  content_hash = hash_with(regions ? mesh.regions : std::vector<std::int32_t>{}, mesh, shape);
  zeros_hash_ = regions ? "" : hash_with(std::vector<std::int32_t>(mesh.tets.size()), mesh, shape);
}

void write_mesh(const std::filesystem::path& path, std::span<const core::Vec3> positions,
                std::span<const std::array<core::VertexId, 4>> tets, std::span<const CellArray> cell_data,
                std::span<const Field> fields, std::span<const std::byte> cut_memory) {
  const std::string ending = lowercase_ending(path);
  if (ending == ".vtu") {
    write_vtu(path, positions, tets, cell_data, fields, cut_memory);
  } else if (ending == ".vtk") {
    write_vtk_legacy(path, positions, tets, cell_data, fields, cut_memory);
  } else if (is_one_of(ending, {".msh", ".msh2"})) {
    write_gmsh(path, positions, tets, regions_in(cell_data), ending == ".msh");
  } else if (ending == ".mesh") {
    write_medit(path, positions, tets, regions_in(cell_data));
  } else if (is_one_of(ending, {".node", ".ele"})) {
    write_tetgen(path, positions, tets, regions_in(cell_data));
  } else {
    throw MeshError(path.string() + ": cannot write tetrahedra to '" + ending + "'; choose " +
                    std::string(mesh_file_endings()));
  }
}

void write_mesh(const std::filesystem::path& path, const core::MeshData& mesh,
                std::span<const Field> fields) {
  std::vector<CellArray> cell_data;
  if (!mesh.regions.empty()) cell_data.push_back({"region", mesh.regions});
  if (!mesh.cut_masks.empty()) cell_data.push_back({std::string(kCutMask), mesh.cut_masks});
  write_mesh(path, mesh.positions, mesh.tets, cell_data, fields, mesh.cut_memory);
}

void write_surface(const std::filesystem::path& path, const Surface& surface,
                   std::span<const CellArray> cell_data) {
  const std::string ending = lowercase_ending(path);
  if (ending == ".stl") {
    write_stl(path, surface);
  } else if (ending == ".ply") {
    write_ply(path, surface, cell_data);
  } else if (ending == ".off") {
    write_off(path, surface);
  } else if (ending == ".obj") {
    write_obj(path, surface);
  } else if (ending == ".vtp") {
    write_vtp(path, surface, cell_data);
  } else {
    throw MeshError(path.string() + ": cannot write a surface to '" + ending + "'; choose " +
                    std::string(surface_file_endings()));
  }
}

}  // namespace incise::mesh_io
