#include "server/app/offline/cut_file.hpp"

#include <array>
#include <bit>
#include <cerrno>
#include <fstream>
#include <system_error>

#include "client/cli/usage.hpp"
#include "server/core/geometry/quality.hpp"

namespace incise::app {

namespace fs = std::filesystem;

namespace {

std::string lowercase_ending(const fs::path& path) {
  std::string ending = path.extension().string();
  for (char& c : ending) c = static_cast<char>(c >= 'A' && c <= 'Z' ? c + 32 : c);
  return ending;
}

bool is_glb_file(const fs::path& path) {
  return lowercase_ending(path) == ".glb";
}

}  // namespace

void require_writable(const fs::path& path, const std::string& option) {
  std::error_code error;
  const fs::path parent = path.has_parent_path() ? path.parent_path() : ".";
  if (!fs::is_directory(parent, error)) {
    throw std::runtime_error(option + " " + path.string() + ": the directory " + parent.string() +
                             " does not exist; make it first (mkdir -p " + parent.string() + ")");
  }
  if (path.empty() || !path.has_filename() || fs::is_directory(path, error)) {
    throw std::runtime_error(option + " " + path.string() + ": is a directory; accepted is a file's name");
  }
}

void require_not_read(const fs::path& out, std::initializer_list<fs::path> read, const std::string& option) {
  const auto files = [](const fs::path& path) {
    const bool of_pair = path.extension() == ".node" || path.extension() == ".ele";
    const std::string base = of_pair ? fs::path(path).replace_extension().string() : path.string();
    return std::array{path, fs::path(base + ".node"), fs::path(base + ".ele")};
  };
  for (const fs::path& input : read) {
    for (const fs::path& from : files(input)) {
      for (const fs::path& to : files(out)) {
        std::error_code error;
        if (!from.empty() && fs::equivalent(from, to, error))
          throw client::UsageError(option + " " + out.string() + ": would overwrite " + from.string() +
                                   ", which is read; choose another name");
      }
    }
  }
}

void require_mesh_output(const fs::path& path, const std::string& option) {
  if (path.has_extension() && !mesh_io::is_mesh_file(path) && !mesh_io::is_surface_file(path) &&
      !is_glb_file(path)) {
    throw client::UsageError(
        option + " " + path.string() + ": cannot write \"" + path.extension().string() + "\"; choose " +
        std::string(mesh_io::mesh_file_endings()) + " for tetrahedra, " +
        std::string(mesh_io::surface_file_endings()) +
        " for the surface, .glb for the surface with its textures, or no ending for TetGen's pair");
  }
  require_writable(path, option);
  if (lowercase_ending(path) == ".obj") mesh_io::require_own_materials(path);
}

bool keeps_fields(const fs::path& path) {
  const std::string ending = lowercase_ending(path);
  return ending == ".vtu" || ending == ".vtk";
}

bool keeps_materials(const fs::path& path) {
  return is_glb_file(path) || lowercase_ending(path) == ".obj";
}

void write_cut_mesh(const fs::path& path, const core::TetMesh& mesh, const mesh_io::Surface* from,
                    const core::CarriedFields* fields, const std::vector<RegionMaterials>* regions) {
  const auto shown = [&] {
    return cut_surface(mesh, from,
                       regions != nullptr ? *regions : region_materials({}, mesh.export_data(), ""));
  };
  if (is_glb_file(path)) {
    write_glb(path, shown());
    return;
  }
  if (mesh_io::is_surface_file(path) && (from != nullptr || keeps_materials(path))) {
    CutSurface cut = shown();
    const mesh_io::CellArray arrays[] = {{"origin", std::move(cut.origins)},
                                         {"cut", std::move(cut.cut)},
                                         {"piece", std::move(cut.pieces)},
                                         {"material", cut.surface.look.material_of}};
    mesh_io::write_surface(path, cut.surface, arrays);
    return;
  }
  const core::MeshData data = mesh.export_data();
  if (mesh_io::is_surface_file(path)) {
    mesh_io::write_surface(path, mesh_io::boundary_surface(data.positions, data.tets));
    return;
  }
  if (!path.has_extension()) {
    fs::path node = path;
    node += ".node";
    mesh_io::write_mesh(node, data);
    return;
  }
  const std::vector<std::uint32_t> pieces = core::label_pieces(mesh);
  std::vector<std::uint32_t> ids, piece;
  std::vector<std::uint8_t> mask, faces;
  std::vector<double> dihedral, volume;
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    ids.push_back(t);
    piece.push_back(pieces[t]);
    mask.push_back(mesh.cut_mask(t));
    faces.push_back(static_cast<std::uint8_t>(std::popcount(mesh.cut_mask(t))));
    dihedral.push_back(core::measure_to_degrees(mesh.worst_dihedral(t)));
    volume.push_back(mesh.volume(t));
  }
  std::vector<mesh_io::CellArray> arrays = {
      {"tet_id", std::move(ids)},      {"region", data.regions},
      {"piece", std::move(piece)},     {"cut_mask", std::move(mask)},
      {"cut_faces", std::move(faces)}, {"min_dihedral_deg", std::move(dihedral)},
      {"volume", std::move(volume)}};
  if (from != nullptr) {
    const auto origins = face_origins(mesh, *from);
    for (std::size_t f = 0; f < 4; ++f) {
      std::vector<std::uint32_t> of_face;
      for (const auto& four : origins) of_face.push_back(four[f]);
      arrays.push_back({"origin_" + std::to_string(f), std::move(of_face)});
    }
  }
  mesh_io::write_mesh(path, data.positions, data.tets, arrays,
                      fields != nullptr ? fields->exported(mesh) : std::vector<mesh_io::Field>{});
}

void finish_writing(std::ofstream& out, const fs::path& path) {
  const bool opened = out.is_open();
  out.close();
  if (out) return;
  const int reason = errno;
  if (opened) remove_unfinished(path);
  throw std::runtime_error(path.string() + ": cannot be written: " + std::generic_category().message(reason));
}

void write_text(const fs::path& path, const std::string& text) {
  std::ofstream out(path, std::ios::binary);
  out << text;
  finish_writing(out, path);
}

void remove_unfinished(const fs::path& path) {
  std::error_code ignored;
  if (fs::is_regular_file(path, ignored)) fs::remove(path, ignored);
}

}  // namespace incise::app
