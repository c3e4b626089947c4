#include "server/app/offline/cut_file.hpp"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <fstream>
#include <span>
#include <system_error>

#include "client/cli/output_file.hpp"
#include "client/cli/usage.hpp"
#include "server/app/offline/terminal.hpp"
#include "server/core/geometry/quality.hpp"
#include "server/core/session/piece_numbers.hpp"
#include "server/mesh_io/tetgen_files.hpp"
#include "server/mesh_io/text_file.hpp"
#include "server/mesh_io/write_materials.hpp"

namespace incise::app {

namespace fs = std::filesystem;

namespace {

std::string lowercase_ending(const fs::path& path) {
  return mesh_io::lowercase(path.extension().string());
}

bool is_glb_file(const fs::path& path) {
  return lowercase_ending(path) == ".glb";
}

std::vector<fs::path> files_of(const Output& out) {
  if (out.path.empty()) return {};
  return out.kind == Output::Kind::kMesh ? files_of_mesh(out.path) : std::vector{out.path};
}

// An input can be the base of a TetGen mesh, and an .obj has a library of materials. Only files that are there.
std::vector<fs::path> files_read(const fs::path& input) {
  if (input.empty()) return {};
  const auto [node, ele] = mesh_io::tetgen_paths(input);
  std::vector<fs::path> files{input, node, ele};
  if (lowercase_ending(input) == ".obj") files.push_back(mesh_io::material_library_of(input));
  std::erase_if(files, [](const fs::path& file) {
    std::error_code error;
    return !fs::exists(file, error);
  });
  return files;
}

// Also where the file is not there yet.
bool same_file(const fs::path& a, const fs::path& b) {
  const auto place = [](const fs::path& path) {
    std::error_code error;
    return fs::weakly_canonical(fs::absolute(path, error), error);
  };
  std::error_code error;
  return fs::equivalent(a, b, error) || place(a) == place(b);
}

// Throws if `out` would overwrite one of `files`; `why` follows its name.
void require_apart(const Output& out, const std::vector<fs::path>& files, const std::string& why) {
  for (const fs::path& to : files_of(out)) {
    for (const fs::path& file : files) {
      if (same_file(to, file))
        throw client::UsageError(out.option + " " + out.path.string() + ": would overwrite " + file.string() +
                                 why + "; choose another name");
    }
  }
}

// Throws if `path`, of this output, cannot become what it is to be.
void require_writable(const Output& out, const fs::path& path) {
  client::require_can_be_file(out.option, path);
  std::error_code error;
  if (out.kind != Output::Kind::kText && fs::exists(path, error) && !fs::is_regular_file(path, error)) {
    throw std::runtime_error(out.option + " " + path.string() +
                             ": is a device or a pipe; accepted is the name of a new file, or of a regular "
                             "one, which is replaced");
  }
}

// Removes a file that could not be written to its end. A pipe or device stays.
void remove_unfinished(const fs::path& path) {
  std::error_code ignored;
  if (fs::is_regular_file(path, ignored)) fs::remove(path, ignored);
}

void require_kind(const Output& out) {
  const fs::path& path = out.path;
  if (out.kind == Output::Kind::kMesh && path.has_extension() && !mesh_io::is_mesh_file(path) &&
      !mesh_io::is_surface_file(path) && !is_glb_file(path)) {
    throw client::UsageError(
        out.option + " " + path.string() + ": cannot write \"" + path.extension().string() + "\"; choose " +
        std::string(mesh_io::mesh_file_endings()) + " for tetrahedra, " +
        std::string(mesh_io::surface_file_endings()) +
        " for the surface, .glb for the surface with its textures, or no ending for TetGen's pair");
  }
  require_writable(out, path);
  std::error_code error;
  if (out.kind == Output::Kind::kMesh && !path.has_extension() && fs::exists(path, error)) {
    throw client::UsageError(out.option + " " + path.string() +
                             ": is a file; without an ending it names TetGen's pair beside that, " +
                             path.string() + ".node and .ele; choose another name or an ending");
  }
  for (const fs::path& file : files_of(out)) require_writable(out, file);
  if (out.kind == Output::Kind::kMesh && lowercase_ending(path) == ".obj")
    mesh_io::require_own_materials(path);
}

}  // namespace

void require_outputs(const std::vector<Output>& outputs, const std::vector<fs::path>& read) {
  for (const Output& out : outputs) {
    if (out.path.empty()) continue;
    require_kind(out);
    require_not_read(out, read);
    for (const Output& other : outputs) {
      if (&other == &out) break;
      require_apart(out, files_of(other), ", which " + other.option + " writes");
    }
  }
}

void require_not_read(const Output& out, const std::vector<fs::path>& read) {
  for (const fs::path& input : read) require_apart(out, files_read(input), ", which is read");
}

void require_mesh_output(const fs::path& path, const std::string& option) {
  require_kind({path, option, Output::Kind::kMesh});
}

std::vector<fs::path> files_of_mesh(const fs::path& path) {
  const std::string ending = lowercase_ending(path);
  if (ending.empty() || ending == ".node" || ending == ".ele") {
    const auto [node, ele] = mesh_io::tetgen_paths(path);
    return {node, ele};
  }
  if (ending == ".obj") return {path, mesh_io::material_library_of(path)};
  return {path};
}

void print_written(const std::vector<fs::path>& files) {
  std::string names;
  for (const fs::path& file : files) names += (names.empty() ? "" : ", ") + file.string();
  print_row("written", names);
}

bool keeps_fields(const fs::path& path) {
  const std::string ending = lowercase_ending(path);
  return ending == ".vtu" || ending == ".vtk";
}

std::string fields_left_out(const fs::path& path, std::span<const mesh_io::Field> fields) {
  if (fields.empty() || keeps_fields(path)) return {};
  constexpr std::size_t kNamed = 4;
  std::string names;
  for (const mesh_io::Field& field : fields.first(std::min(fields.size(), kNamed)))
    names += (names.empty() ? "" : ", ") + field.name;
  if (fields.size() > kNamed) names += " and " + std::to_string(fields.size() - kNamed) + " more";
  return path.string() + ": is without the body's fields (" + names + "); .vtu and .vtk have them";
}

std::string cuts_left_out(const fs::path& path, const core::TetMesh& mesh) {
  if (keeps_fields(path) || mesh_io::is_surface_file(path) || is_glb_file(path)) return {};
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t) || mesh.cut_mask(t) == 0) continue;
    return path.string() +
           ": does not say which faces are cuts, so a further cut takes them for the body's boundary; .vtu "
           "and .vtk say it";
  }
  return {};
}

bool keeps_materials(const fs::path& path) {
  return is_glb_file(path) || lowercase_ending(path) == ".obj";
}

std::vector<mesh_io::Field> saved_fields(const core::CutSession& session) {
  using mesh_io::Field;
  const core::TetMesh& mesh = session.mesh();
  std::vector<Field> fields = session.fields().exported(mesh);
  const bool has_it = std::ranges::any_of(fields, [](const Field& field) {
    return field.on == Field::On::kVertices && field.name == mesh_io::kRestPosition;
  });
  if (!mesh.deformed() || has_it) return fields;
  std::vector<float> rest;
  rest.reserve(3 * std::size_t{mesh.vertex_slots()});
  for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) {
    const core::Vec3 p = mesh.rest_position(v);
    for (const double x : {p.x, p.y, p.z}) rest.push_back(static_cast<float>(x));
  }
  const Field by_id{std::string(mesh_io::kRestPosition), Field::On::kVertices, 3, std::move(rest)};
  fields.push_back(core::exported_rows(std::span(&by_id, 1), mesh).front());
  return fields;
}

namespace {

// `session`: whose mesh it is; null where it is none's.
void write_mesh_of(const fs::path& path, const core::TetMesh& mesh, const core::CutSession* session,
                   const mesh_io::Surface* from, const std::vector<RegionMaterials>* regions) {
  const auto piece_of = [&] {
    return session != nullptr ? core::piece_numbers(*session) : core::piece_numbers(mesh);
  };
  const auto shown = [&] {
    return cut_surface(mesh, piece_of(), from,
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
  const core::MeshData data = session != nullptr ? session->export_data() : mesh.export_data();
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
  const std::vector<std::uint32_t> pieces = piece_of();
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
      {"piece", std::move(piece)},     {std::string(mesh_io::kCutMask), std::move(mask)},
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
                      session != nullptr ? saved_fields(*session) : std::vector<mesh_io::Field>{},
                      data.cut_memory);
}

}  // namespace

void write_cut_mesh(const fs::path& path, const core::CutSession& session, const mesh_io::Surface* from,
                    const std::vector<RegionMaterials>* regions) {
  write_mesh_of(path, session.mesh(), &session, from, regions);
}

void write_cut_mesh(const fs::path& path, const core::TetMesh& mesh, const mesh_io::Surface* from) {
  write_mesh_of(path, mesh, nullptr, from, nullptr);
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

}  // namespace incise::app
