#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

#include "client/cli/shown_name.hpp"
#include "client/cli/usage.hpp"
#include "server/app/body.hpp"
#include "server/app/offline/commands.hpp"
#include "server/app/offline/cut_file.hpp"
#include "server/app/offline/motion_run.hpp"
#include "server/app/offline/source_names.hpp"
#include "server/base/hex.hpp"
#include "server/base/wording.hpp"
#include "server/core/mesh/measure.hpp"
#include "server/input/hid/device_profile.hpp"
#include "server/loop/checkpoint_file.hpp"
#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/phantom.hpp"
#include "server/mesh_io/surface_check.hpp"
#include "server/mesh_io/text_file.hpp"
#include "server/mesh_io/volume_image.hpp"
#include "server/mesh_io/vtk_xml.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

Json point(const core::Vec3& p) {
  return Json::array({p.x, p.y, p.z});
}

core::Vec3 point_of(const Json& p) {
  return {p[0].get<double>(), p[1].get<double>(), p[2].get<double>()};
}

Json corners(const Box& box) {
  return {{"min", point(box.low)}, {"max", point(box.high)}};
}

Json describe_mesh(const mesh_io::LoadedMesh& loaded) {
  const core::TetMesh mesh(loaded.mesh);
  const core::CutReport report = core::measure(mesh);
  std::set<std::int32_t> regions(loaded.mesh.regions.begin(), loaded.mesh.regions.end());
  if (regions.empty()) regions.insert(0);
  Json facts;
  facts["kind"] = "tetrahedral mesh";
  facts["vertices"] = loaded.mesh.positions.size();
  facts["tets"] = report.tets;
  facts["boundary_faces"] = report.boundary_faces;
  facts["pieces"] = report.pieces;
  if (mesh.came_cut()) facts["cut_faces"] = report.cut_faces;
  if (!loaded.mesh.cut_memory.empty()) facts["cut_memory_bytes"] = loaded.mesh.cut_memory.size();
  facts["regions"] = regions;
  facts["volume_m3"] = report.volume;
  facts["mean_edge_length_m"] = mesh.mean_edge_length();
  facts["min_dihedral_deg"] = report.min_dihedral_deg;
  facts["inverted"] = report.inverted;
  facts["box_m"] = corners(box_of(loaded.mesh));
  facts["content_hash"] = loaded.content_hash;
  for (const mesh_io::Field& field : loaded.fields) {
    facts["fields"].push_back({{"name", field.name},
                               {"on", field.on == mesh_io::Field::On::kVertices ? "vertices" : "tetrahedra"},
                               {"components", field.components},
                               {"type", field.values.index() == 0 ? "float32" : "int32"}});
  }
  facts["warnings"] = loaded.warnings;
  return facts;
}

Json describe_surface(const fs::path& file) {
  std::vector<std::string> warnings;
  mesh_io::Surface surface = mesh_io::read_surface(file, warnings);
  Box bounds;
  for (const core::Vec3& p : surface.positions) bounds.add(p);
  Json facts;
  facts["kind"] = "surface";
  facts["vertices"] = surface.positions.size();
  facts["triangles"] = surface.triangles.size();
  facts["box_file_units"] = corners(bounds);
  const mesh_io::SurfaceLook& look = surface.look;
  for (const auto& [name, is_there] : {std::pair{"texture coordinates", !look.uvs.empty()},
                                       {"normals", !look.normals.empty()},
                                       {"colours", !look.colours.empty()}}) {
    if (is_there) facts["corners_have"].push_back(name);
  }
  for (const mesh_io::Material& material : look.materials)
    facts["materials"].push_back({{"name", material.name}, {"texture", material.image_type}});
  try {
    facts["volume_file_units"] = mesh_io::check_surface(std::move(surface), file.string(), warnings).volume;
    facts["fillable"] = true;
  } catch (const mesh_io::MeshError& error) {
    facts["fillable"] = false;
    facts["problem"] = error.what();
  }
  facts["warnings"] = warnings;
  return facts;
}

// The ending with which write_surface() makes VTK's poly data.
bool is_poly_data(const fs::path& file) {
  return mesh_io::lowercase(file.extension().string()) == ".vtp";
}

Json describe_poly_data(const fs::path& file) {
  const std::string bytes = mesh_io::read_whole_file(file);
  const auto pieces =
      mesh_io::read_vtk_xml(bytes, file.string(), true, mesh_io::VtkXmlKind::kPolyData).pieces;
  std::size_t vertices = 0, cells = 0;
  Box bounds;
  for (const mesh_io::VtkXmlPiece& piece : pieces) {
    const std::size_t numbers = piece.point_arrays.empty() ? 0 : piece.point_arrays[0].values.size();
    if (numbers != 3 * piece.points)
      throw mesh_io::MeshError(file.string() + ": the points are " + std::to_string(numbers) +
                               " numbers; the piece declares " + std::to_string(3 * piece.points));
    for (std::size_t i = 0; i < numbers; i += 3) {
      const double* const x = &piece.point_arrays[0].values[i];
      bounds.add({x[0], x[1], x[2]});
    }
    vertices += piece.points;
    cells += piece.cells;
  }
  Json facts;
  facts["kind"] = "surface, VTK poly data";
  facts["vertices"] = vertices;
  facts["faces"] = cells;
  if (vertices > 0) facts["box_file_units"] = corners(bounds);
  const auto list = [&](const std::vector<mesh_io::VtkXmlArray>& arrays, const char* on) {
    for (const mesh_io::VtkXmlArray& array : arrays) {
      facts["fields"].push_back({{"name", array.name},
                                 {"on", on},
                                 {"components", array.components},
                                 {"type", mesh_io::lowercase(array.type)}});
    }
  };
  if (!pieces.empty()) {
    list(pieces[0].point_data, "vertices");
    list(pieces[0].cell_data, "faces");
  }
  facts["fillable"] = false;
  facts["problem"] = "incise writes .vtp, but fills only " + std::string(mesh_io::surface_input_endings());
  facts["warnings"] = Json::array();
  return facts;
}

Json describe_image(const fs::path& file) {
  const mesh_io::VolumeImage image = mesh_io::read_volume_image(file);
  const mesh_io::Affine& m = image.mm_from_unit;
  Json facts;
  facts["kind"] = "volume image";
  facts["voxels"] = image.file_size;
  facts["type"] = mesh_io::to_string(image.file_type);
  Json spacing;
  for (std::size_t i = 0; i < 3; ++i)
    spacing.push_back(core::length({m[0][i], m[1][i], m[2][i]}) / image.file_size[i]);
  facts["spacing_mm"] = spacing;
  facts["space"] = image.anatomical ? "LPS" : "not named";
  Box bounds;
  for (int corner = 0; corner < 8; ++corner) {
    bounds.add(mesh_io::apply(m, {static_cast<double>(corner & 1), static_cast<double>(corner >> 1 & 1),
                                  static_cast<double>(corner >> 2)}));
  }
  facts["box_mm"] = corners(bounds);
  if (image.size != image.file_size) facts["averaged_to"] = image.size;
  const auto [least, most] = std::minmax_element(image.values.begin(), image.values.end());
  facts["values"] = {static_cast<double>(*least), static_cast<double>(*most)};
  facts["warnings"] = Json::array();
  return facts;
}

// What a source did. Path and times are of the poses that a session takes, and each holder's are summed: the clocks of two
// have nothing to do with each other, and the blade did not go from one to the other.
class SourceFigures {
 public:
  // The next pose is another holder's.
  void begin_clock() { last_.reset(); }

  void add(const core::Pose& pose) {
    ++poses_;
    if (pose.buttons != 0) ++held_;
    const core::Quat& q = pose.orientation;
    if (!std::isfinite(core::length(pose.position)) || !std::isfinite(q.w + q.x + q.y + q.z)) {
      ++not_finite_;
      return;
    }
    if (last_ && pose.t_ns <= last_->t_ns) return;
    if (last_) {
      // Up to 2^64 - 1 ns: more than the signed difference can hold.
      const std::uint64_t dt_ns =
          static_cast<std::uint64_t>(pose.t_ns) - static_cast<std::uint64_t>(last_->t_ns);
      const double dt_s = static_cast<double>(dt_ns) * 1e-9;
      const double step_m = core::distance(pose.position, last_->position);
      duration_s_ += dt_s;
      path_m_ += step_m;
      fastest_m_s_ = std::max(fastest_m_s_, step_m / dt_s);
      gaps_s_.push_back(dt_s);
    }
    last_ = pose;
  }

  Json json(std::uint32_t number) {
    std::sort(gaps_s_.begin(), gaps_s_.end());
    Json facts{{"source", number},
               {"poses", poses_},
               {"duration_s", duration_s_},
               {"rate_hz", gaps_s_.empty() ? 0.0 : 1 / gaps_s_[gaps_s_.size() / 2]},
               {"longest_gap_s", gaps_s_.empty() ? 0.0 : gaps_s_.back()},
               {"path_m", path_m_},
               {"fastest_m_s", fastest_m_s_},
               {"poses_with_a_button", held_}};
    if (not_finite_ > 0) facts["poses_not_finite"] = not_finite_;
    return facts;
  }

 private:
  std::size_t poses_ = 0, held_ = 0, not_finite_ = 0;
  double duration_s_ = 0, path_m_ = 0, fastest_m_s_ = 0;
  std::vector<double> gaps_s_;
  std::optional<core::Pose> last_;
};

Json describe_motion(const RecordedMotion& motion) {
  Json facts;
  facts["kind"] = motion.format == "capture" ? "capture" : "motion, " + motion.format;
  if (motion.header) {
    facts["software"] = motion.header->software;
    facts["mesh"] = motion.header->mesh_path;
    facts["mesh_content_hash"] = motion.header->mesh_content_hash;
    facts["config"] = Json::parse(motion.header->config_json);
    facts["records"] = motion.records;
    facts["batch_marks"] = motion.marks.size();
    facts["last_revision"] = motion.marks.empty() ? 0 : motion.marks.back().revision;
    facts["checkpoints"] = motion.checkpoints.size();
    if (motion.undos > 0) facts["undone_strokes"] = motion.undos;
    facts["closed"] = motion.closed;
  }
  facts["poses"] = motion.poses();
  if (const std::size_t n = motion.count(MotionEvent::Kind::kDeform); n > 0) facts["deformations"] = n;
  std::map<std::uint32_t, SourceFigures> by_source;
  Box bounds;
  bool bounded = false;
  for (const MotionEvent& event : motion.events) {
    // Where the clock of a text motion restarts, its stroke ends.
    const bool other_clock = event.kind == MotionEvent::Kind::kOpened ||
                             (event.kind == MotionEvent::Kind::kEndStroke && !motion.header);
    if (const auto there = by_source.find(event.source); other_clock && there != by_source.end())
      there->second.begin_clock();
    if (event.kind != MotionEvent::Kind::kPose) continue;
    by_source[event.source].add(event.pose);
    if (!core::is_finite(event.pose.position)) continue;
    bounds.add(event.pose.position);
    bounded = true;
  }
  Json sources = Json::array();
  const auto names = source_names(motion);
  for (auto& [number, figures] : by_source) {
    sources.push_back(figures.json(number));
    if (const auto known = names.find(number); known != names.end()) {
      sources.back()["names"] = known->second.names;
      if (known->second.others > 0) sources.back()["other_names"] = known->second.others;
    }
  }
  facts["sources"] = sources;
  if (bounded) facts["box_m"] = corners(bounds);
  facts["warnings"] = motion.warnings;
  return facts;
}

bool looks_like_config(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  char c = 0;
  while (in.get(c) && (c == ' ' || c == '\n' || c == '\r' || c == '\t')) {
  }
  return in && (c == '{' || (c == '/' && file.extension() == ".json"));
}

Json describe_config(const fs::path& file) {
  const Config config = load_config(file);
  const std::string mesh =
      !config.mesh.phantom.empty() ? config.mesh.phantom + " (phantom)" : config.mesh.path;
  return {{"kind", "configuration"},
          {"mesh", mesh.empty() ? "none" : mesh},
          {"values", Json::parse(compact(config))}};
}

Json describe_relay_config(const fs::path& file) {
  const Config config = load_config(file, Program::kRelay);
  std::string upstreams;
  for (const Config::Relay::Session& session : config.relay.all(config.listen))
    upstreams += (upstreams.empty() ? "" : ", ") + session.upstream;
  return {{"kind", "configuration of incise-relay"},
          {"follows", upstreams.empty() ? "none" : upstreams},
          {"for", "incise-relay --check " + file.string() + ", which says more"}};
}

std::string known_files() {
  return "a mesh (" + std::string(mesh_io::mesh_file_endings()) + ", .veg), a surface (" +
         std::string(mesh_io::surface_input_endings()) +
         ", .vtp), a volume image (.nrrd, .nhdr, .nii, .nii.gz), a motion (TUM lines t x y z qx qy qz qw, or "
         "CSV with the header t_s,x_m,y_m,z_m...), a capture or its checkpoint, a configuration of incised "
         "or "
         "incise-relay, a device profile, a report of incise cut, or the specification or manifest.json of "
         "incise sweep";
}

Json describe_checkpoint(const loop::Checkpoint& checkpoint) {
  return {
      {"kind", "checkpoint of a capture"},
      {"for", "incised --resume, which reads it beside its capture; incise info and replay describe that"},
      {"revision", checkpoint.revision},
      {"state_hash", hex(checkpoint.state_hash)},
      {"capture_bytes_before", checkpoint.offset},
      {"capture_records_before", checkpoint.records},
      {"state_bytes", checkpoint.state.size()}};
}

// Decides by the contents: a configuration, a checkpoint, a capture, or a motion; from a pipe only one of the last two.
Json describe_contents(const fs::path& file) {
  std::error_code ignored;
  const bool pipe = !fs::is_regular_file(file, ignored);  // can be read once
  if (!pipe && loop::begins_as_checkpoint(file.string())) {
    std::string why;
    if (const auto checkpoint = loop::read_checkpoint(file.string(), why))
      return describe_checkpoint(*checkpoint);
    throw std::runtime_error(why + "; incised --resume does without it");
  }
  if (!pipe && looks_like_config(file)) {
    const Json json = Json::parse(std::ifstream(file), nullptr, false, true);
    if (json.is_object() && json.contains("tools")) {
      return {{"kind", "device profile"}, {"name", input::load_profile(file).name}};
    }
    if (json.is_object() && json.contains("state_hash")) return {{"kind", "report of incise cut"}};
    if (json.is_object() && json.contains("relay")) return describe_relay_config(file);
    if (json.is_object() && json.contains("shards") && json.contains("spec")) {
      return {{"kind", "manifest of a data set of incise sweep"},
              {"samples", json.value("samples", Json())},
              {"complete", json.value("complete", Json())}};
    }
    if (json.is_object() && json.contains("bodies") && json.contains("motions")) {
      return {{"kind", "specification of incise sweep"},
              {"bodies", json["bodies"].size()},
              {"motions", json["motions"].size()}};
    }
    return describe_config(file);
  }
  try {
    return describe_motion(read_recorded_motion(file));
  } catch (const protocol::EmptyMotion& error) {
    const std::string name = file.string() + ": ";
    throw std::runtime_error(name + "holds no poses: " + std::string(error.what()).substr(name.size()));
  } catch (const protocol::NotAMotion&) {
    throw std::runtime_error(
        file.string() +
        (pipe ? ": not a motion or a capture; save anything else that comes from a pipe to a file"
              : ": not a file that incise knows; it knows " + known_files()));
  }
}

void print(const Json& facts) {
  for (const auto& [name, value] : facts.items()) {
    if (name == "warnings") {
      for (const auto& warning : value)
        std::fprintf(stderr, "warning: %s\n", warning.get<std::string>().c_str());
    } else if (name == "sources") {
      for (const Json& source : value) {
        std::string line;
        for (const auto& [key, number] : source.items()) {
          if (key == "source" || key == "names" || key == "other_names") continue;
          line += (line.empty() ? "" : ", ") + key + " " +
                  (number.is_number_float() ? short_number(number.get<double>()) : number.dump());
        }
        std::string names;
        for (const Json& holder : source.value("names", Json::array()))
          names += (names.empty() ? "" : ", ") + client::shown_name(holder.get<std::string>());
        if (const std::size_t others = source.value("other_names", std::size_t{0}); others > 0)
          names += " and " + std::to_string(others) + (others == 1 ? " other" : " others");
        print_row("source " + source["source"].dump(), names.empty() ? line : names + ": " + line);
      }
    } else if (name == "fields") {
      for (const Json& field : value) {
        print_row("field", field["name"].get<std::string>() + ", on " + field["on"].get<std::string>() +
                               ", " + field["components"].dump() + " " + field["type"].get<std::string>());
      }
    } else if (name == "materials") {
      for (const Json& material : value) {
        const auto texture = material["texture"].get<std::string>();
        print_row("material", material["name"].get<std::string>() + (texture.empty() ? "" : ", " + texture));
      }
    } else if (name == "corners_have") {
      std::string line;
      for (const Json& what : value) line += (line.empty() ? "" : ", ") + what.get<std::string>();
      print_row("corners have", line);
    } else if (name == "config") {
      print_row(name, "shown with --json");
    } else if (value.is_object() && value.contains("min")) {
      print_row(name, Box{point_of(value["min"]), point_of(value["max"])}.text());
    } else if (value.is_array() && !value.empty() && value[0].is_number_float()) {
      std::string line;
      for (const Json& number : value)
        line += (line.empty() ? "" : ", ") + short_number(number.get<double>());
      print_row(name, line);
    } else {
      print_row(name, value.is_string()         ? value.get<std::string>()
                      : value.is_number_float() ? short_number(value.get<double>())
                                                : value.dump());
    }
  }
}

}  // namespace

int run_info(const InfoCommand& command) {
  const fs::path& file = command.file;
  if (file.empty()) throw client::UsageError("FILE is empty; name a file");
  std::error_code error;
  fs::path node = file;
  node += ".node";
  const Config config = command.config.empty() ? Config{} : load_config(command.config);
  Json facts;
  if (is_poly_data(file)) {
    facts = describe_poly_data(file);
  } else if (mesh_io::is_volume_image(file)) {
    facts = describe_image(file);
  } else if (mesh_io::is_surface_input(file) || mesh_io::is_surface_file(file)) {
    facts = describe_surface(file);
  } else if (mesh_io::is_mesh_input(file) || (!fs::exists(file, error) && fs::exists(node, error))) {
    mesh_io::LoadOptions options = load_options(config);
    options.fields = true;
    facts = describe_mesh(mesh_io::load_mesh(file, options));
  } else if (!fs::exists(file, error)) {
    throw std::runtime_error(file.string() + ": no such file; accepted is " + known_files());
  } else {
    facts = describe_contents(file);
  }
  Json named{{"file", file.string()}};
  named.update(facts);
  if (command.json) {
    std::printf("%s\n", named.dump(2).c_str());
  } else if (facts["kind"] == "configuration") {
    print_row("kind", "configuration of incised");
    print_row("mesh", facts["mesh"].get<std::string>() + "; incised --check " + file.string() + " says more");
  } else {
    print(named);
  }
  return 0;
}

int run_phantom(const PhantomCommand& command) {
  const auto kind = mesh_io::phantom_kind(command.kind);
  if (!kind)
    throw client::UsageError("found \"" + command.kind + "\"; accepted are liver, cylinder and slab");
  require_mesh_output(command.out, "--out");
  Json facts;
  std::vector<std::string> warnings;
  std::vector<fs::path> files;
  if (mesh_io::is_surface_file(command.out)) {
    const mesh_io::Surface surface = mesh_io::make_phantom_surface(*kind, command.size);
    mesh_io::write_surface(command.out, surface);
    files = {command.out};  // it has no materials
    facts = {
        {"kind", "surface"}, {"vertices", surface.positions.size()}, {"triangles", surface.triangles.size()}};
  } else {
    Progress filling("making the " + command.kind);
    mesh_io::FillOptions options;
    options.target_tets = command.size;
    options.progress = [&](std::string_view stage, double) { filling.show(-1, stage); };
    core::MeshData data = mesh_io::make_phantom(*kind, options, warnings);
    if (command.capsule) mesh_io::add_capsule(data, 1);
    const core::TetMesh mesh(data);
    write_cut_mesh(command.out, mesh);
    files = files_of_mesh(command.out);
    facts = {{"kind", "tetrahedral mesh"},
             {"vertices", data.positions.size()},
             {"tets", data.tets.size()},
             {"min_dihedral_deg", core::measure(mesh).min_dihedral_deg}};
  }
  facts["warnings"] = warnings;
  if (command.json) {
    facts["out"] = command.out.string();
    std::printf("%s\n", facts.dump(2).c_str());
  } else {
    print(facts);
    print_written(files);
  }
  return 0;
}

}  // namespace incise::app
