#include "server/mesh_io/mesh_io.hpp"

#include <algorithm>
#include <cmath>

#include "server/mesh_io/hash.hpp"
#include "server/mesh_io/surface_check.hpp"
#include "server/mesh_io/surface_files.hpp"
#include "server/mesh_io/tet_repair.hpp"
#include "server/mesh_io/tetgen_files.hpp"
#include "server/mesh_io/write_vtk.hpp"

namespace incise::mesh_io {
namespace {

std::string lowercase_ending(const std::filesystem::path& path) {
  std::string ending = path.extension().string();
  std::transform(ending.begin(), ending.end(), ending.begin(),
                 [](unsigned char c) { return static_cast<char>(c >= 'A' && c <= 'Z' ? c + 32 : c); });
  return ending;
}

bool is_one_of(std::string_view ending, std::initializer_list<std::string_view> endings) {
  return std::find(endings.begin(), endings.end(), ending) != endings.end();
}

// False, rather than an exception, where a directory on the way may not be looked into.
bool is_there(const std::filesystem::path& path) {
  std::error_code error;
  return std::filesystem::exists(path, error);
}

void scale(std::vector<core::Vec3>& positions, double factor) {
  if (factor == 1) return;
  for (core::Vec3& p : positions) p = factor * p;
}

}  // namespace

std::string_view mesh_file_endings() {
  return ".vtu, .node, .ele";
}
std::string_view surface_file_endings() {
  return ".stl, .ply, .off, .obj, .vtp";
}
bool is_mesh_file(const std::filesystem::path& path) {
  return is_one_of(lowercase_ending(path), {".vtu", ".node", ".ele"});
}
bool is_surface_file(const std::filesystem::path& path) {
  return is_one_of(lowercase_ending(path), {".stl", ".ply", ".off", ".obj", ".vtp"});
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
  if (is_one_of(ending, {".stl", ".ply", ".off", ".obj"})) {
    Surface surface = read_surface(path, loaded.warnings);
    scale(surface.positions, options.scale_to_metres);
    const ClosedSurface closed = check_surface(std::move(surface), file, loaded.warnings);
    Fill fill = fill_surface(closed, file, options.fill, loaded.warnings);
    loaded.mesh = std::move(fill.mesh);
    loaded.filled = true;
    loaded.from_cache = fill.from_cache;
    file += " (filled)";
  } else if (is_one_of(ending, {".node", ".ele"}) || is_there(tetgen_paths(path).node)) {
    loaded.mesh = read_tetgen(path, index_base, loaded.warnings);
    scale(loaded.mesh.positions, options.scale_to_metres);
    file = tetgen_paths(path).ele.string();
  } else if (!is_there(path)) {
    throw MeshError(file + ": no such file");
  } else {
    throw MeshError(
        file + ": the ending '" + ending +
        "' is not a mesh's; .node, .ele (or their common name), .stl, .ply, .off and .obj are accepted");
  }
  repair_tets(loaded.mesh, file, index_base, loaded.warnings);
  loaded.content_hash = mesh_hash(loaded.mesh);
  return loaded;
}

Surface read_surface(const std::filesystem::path& path, std::vector<std::string>& warnings) {
  const std::string ending = lowercase_ending(path);
  if (ending == ".stl") return read_stl(path, warnings);
  if (ending == ".ply") return read_ply(path);
  if (ending == ".off") return read_off(path);
  if (ending == ".obj") return read_obj(path);
  throw MeshError(path.string() + ": the ending '" + ending +
                  "' is not a surface's; .stl, .ply, .off and .obj are accepted");
}

std::string mesh_hash(const core::MeshData& mesh) {
  ContentHash hash;
  hash.add(mesh.positions);
  hash.add(mesh.tets);
  hash.add(mesh.regions);
  return hash.hex();
}

void write_mesh(const std::filesystem::path& path, std::span<const core::Vec3> positions,
                std::span<const std::array<core::VertexId, 4>> tets, std::span<const CellArray> cell_data) {
  const std::string ending = lowercase_ending(path);
  if (ending == ".vtu") {
    write_vtu(path, positions, tets, cell_data);
  } else if (is_one_of(ending, {".node", ".ele"})) {
    std::vector<std::int32_t> regions;
    for (const CellArray& array : cell_data) {
      if (array.name != "region") continue;
      std::visit(
          [&regions](const auto& values) {
            for (const auto value : values) regions.push_back(static_cast<std::int32_t>(value));
          },
          array.values);
    }
    write_tetgen(path, positions, tets, regions);
  } else {
    throw MeshError(path.string() + ": a tetrahedral mesh cannot be written with the ending '" + ending +
                    "'; " + std::string(mesh_file_endings()) + " are accepted");
  }
}

void write_mesh(const std::filesystem::path& path, const core::MeshData& mesh) {
  std::vector<CellArray> cell_data;
  if (!mesh.regions.empty()) cell_data.push_back({"region", mesh.regions});
  write_mesh(path, mesh.positions, mesh.tets, cell_data);
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
    throw MeshError(path.string() + ": a surface cannot be written with the ending '" + ending + "'; " +
                    std::string(surface_file_endings()) + " are accepted");
  }
}

}  // namespace incise::mesh_io
