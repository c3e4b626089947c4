// A mesh file: an error that names the file in one line, or arrays as promised, which the repair then takes or refuses.
// The first line of the input is the file's ending, the rest is the file.

#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "server/mesh_io/surface_check.hpp"
#include "server/mesh_io/tet_files.hpp"
#include "server/mesh_io/tet_repair.hpp"
#include "server/mesh_io/tetgen_files.hpp"
#include "server/mesh_io/vtk_xml.hpp"
#include "tests/fuzz/fuzz_check.hpp"

using namespace incise;
using namespace incise::mesh_io;

namespace {

// A directory for the readers that take a path, removed when the program ends.
class Directory {
 public:
  Directory()
      : path_(std::filesystem::temp_directory_path() / ("incise-fuzz-" + std::to_string(::getpid()))) {
    std::filesystem::create_directories(path_);
  }
  ~Directory() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  std::filesystem::path write(const std::string& name, const std::string& bytes) const {
    std::ofstream(path_ / name, std::ios::binary) << bytes;
    return path_ / name;
  }

 private:
  std::filesystem::path path_;
};

core::MeshData read_tets(const std::string& ending, const std::string& bytes,
                         std::vector<std::string>& warnings, std::vector<Field>& fields) {
  if (ending == "msh") return parse_gmsh(bytes, "mesh", warnings, &fields);
  if (ending == "vtk") return parse_vtk(bytes, "mesh", warnings, &fields);
  if (ending == "vtu") return parse_vtu(bytes, "mesh", warnings, &fields);
  if (ending == "mesh") return parse_medit(bytes, "mesh", warnings, &fields);
  if (ending == "veg") return parse_vega(bytes, "mesh", warnings);
  static const Directory directory;
  const bool nodes = ending == "node";
  directory.write("mesh.node", nodes ? bytes : "4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n");
  int index_base = 0;
  return read_tetgen(directory.write("mesh.ele", nodes ? "1 4 0\n0 0 1 2 3\n" : bytes), index_base, warnings);
}

void check_surface_file(const std::string& ending, const std::string& bytes) {
  static const Directory directory;
  std::vector<std::string> warnings;
  Surface surface = read_surface(directory.write("mesh." + ending, bytes), warnings);
  for (const auto& triangle : surface.triangles) {
    for (const auto v : triangle) FUZZ_CHECK(v < surface.positions.size());
  }
  check_surface(std::move(surface), "mesh", warnings);
}

void check_tets(core::MeshData mesh, std::vector<std::string>& warnings, const std::vector<Field>& fields) {
  for (const Field& field : fields) {
    FUZZ_CHECK(field.components >= 1 && field.components <= core::kMaxFieldComponents);
    FUZZ_CHECK(field.rows() == (field.on == Field::On::kVertices ? mesh.positions.size() : mesh.tets.size()));
  }
  FUZZ_CHECK(mesh.regions.empty() || mesh.regions.size() == mesh.tets.size());
  for (const core::Vec3& p : mesh.positions) FUZZ_CHECK(core::is_finite(p));
  for (const auto& tet : mesh.tets) {
    for (const auto v : tet) FUZZ_CHECK(v < mesh.positions.size());
  }
  repair_tets(mesh, "mesh", 0, warnings);
  FUZZ_CHECK(!mesh.tets.empty());
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string input(reinterpret_cast<const char*>(data), size);
  const std::size_t line_end = input.find('\n');
  if (line_end == input.npos) return 0;
  const std::string ending = input.substr(0, line_end), bytes = input.substr(line_end + 1);
  try {
    if (ending == "stl" || ending == "ply" || ending == "off" || ending == "obj" || ending == "glb") {
      check_surface_file(ending, bytes);
    } else if (ending == "vtp") {
      for (const VtkXmlPiece& piece : read_vtk_xml(bytes, "mesh", true, VtkXmlKind::kPolyData).pieces)
        FUZZ_CHECK(piece.cell_arrays.empty());
    } else {
      std::vector<std::string> warnings;
      std::vector<Field> fields;
      core::MeshData mesh = read_tets(ending, bytes, warnings, fields);
      check_tets(std::move(mesh), warnings, fields);
    }
  } catch (const MeshError& error) {
    const std::string text = error.what();
    FUZZ_CHECK(text.find("mesh") != text.npos && text.find('\n') == text.npos);
  }
  return 0;
}
