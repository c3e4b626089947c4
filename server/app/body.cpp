#include "server/app/body.hpp"

#include <algorithm>
#include <exception>
#include <utility>
#include <variant>

#include "server/app/look.hpp"
#include "server/app/offline/motion_run.hpp"
#include "server/app/surface_asset.hpp"
#include "server/base/wording.hpp"
#include "server/input/hid/json_node.hpp"
#include "server/mesh_io/field.hpp"
#include "server/mesh_io/phantom.hpp"

namespace incise::app {

std::unique_ptr<core::CutSession> Body::session(const core::CutConfig& cut) const {
  return built ? std::make_unique<core::CutSession>(*built, cut)
               : std::make_unique<core::CutSession>(loaded.mesh, cut, loaded.fields);
}

mesh_io::LoadOptions load_options(const Config& config, FillProgress progress) {
  mesh_io::LoadOptions options;
  options.scale_to_metres = config.mesh.scale_to_metres;
  options.fill.tetgen_switches = config.mesh.tetgen_switches;
  options.fill.target_tets = static_cast<std::size_t>(config.mesh.target_tets);
  options.fill.time_limit =
      std::chrono::milliseconds(static_cast<std::int64_t>(1000 * config.mesh.fill_time_limit_s));
  options.fill.memory_limit_mb = static_cast<std::size_t>(config.mesh.fill_memory_limit_mb);
  options.fill.cache_dir = config.resolve(config.mesh.cache_directory);
  options.fill.progress = std::move(progress);
  return options;
}

std::vector<std::string> check_body(const Config& config, const std::string& file) {
  mesh_io::LoadedMesh checked;
  if (config.mesh.phantom.empty()) {
    if (config.mesh.path.empty()) {
      // Nothing to start with, but what there is may be right.
      checked.mesh.positions = {{}};
      std::vector<std::string> of_no_body;
      check_look(config, checked.mesh, file, of_no_body);
      return {};
    }
    try {
      checked = mesh_io::check_mesh(config.resolve(config.mesh.path), load_options(config));
    } catch (const std::exception& error) {
      throw ConfigError(file + ": mesh.path: " + error.what());
    }
  } else {
    checked.mesh.positions =
        mesh_io::make_phantom_surface(*mesh_io::phantom_kind(config.mesh.phantom), mesh_io::kMinPhantomTets)
            .positions;
  }
  check_cuttable(config, checked.mesh, file);
  check_look(config, checked.mesh, file, checked.warnings);
  return std::move(checked.warnings);
}

void check_cuttable(const Config& config, const core::MeshData& body, const std::string& file) {
  const std::string in_file = file.empty() ? "" : file + ": ";
  const Box box = box_of(body);
  const double size_m = box.diagonal();
  for (const core::Vec3& corner : {box.low, box.high}) {
    if (core::length(corner) <= core::kFarthest_m) continue;
    throw ConfigError(in_file + "mesh: reaches from " + box.text() + " m; no pose may be more than " +
                      short_number(core::kFarthest_m / 1000) +
                      " km from the origin: move it there, or set mesh.scale_to_metres");
  }
  const auto check = [&](const std::string& key, const core::Blade& blade) {
    if (const std::string fault = blade_fault(blade, config, size_m); !fault.empty())
      throw ConfigError(in_file + key + ": the blade " + fault);
  };
  check("blade", config.cut.blade);
  for (std::size_t i = 0; i < config.sources.size(); ++i)
    check("sources[" + std::to_string(i) + "]", config.sources[i].blade);
}

namespace {

std::string described(const core::Field& field) {
  return std::to_string(field.components) + (field.values.index() == 1 ? " whole number(s)" : " float(s)");
}

// Zeros. A field that the file has as well must be like it.
void add_declared(const Config& config, mesh_io::LoadedMesh& loaded) {
  for (core::Field& field : declared_fields(config, "")) {
    const auto there = std::find_if(loaded.fields.begin(), loaded.fields.end(), [&](const core::Field& f) {
      return f.name == field.name && f.on == field.on;
    });
    if (there != loaded.fields.end()) {
      if (described(*there) == described(field)) continue;
      throw ConfigError("mesh.fields: " + mesh_io::title(field) + " is one of " + described(field) +
                        "; that of the mesh file has " + described(*there));
    }
    const std::size_t rows =
        field.on == core::Field::On::kTets ? loaded.mesh.tets.size() : loaded.mesh.positions.size();
    std::visit([&](auto& values) { values.assign(rows * field.components, 0); }, field.values);
    loaded.fields.push_back(std::move(field));
  }
  if (loaded.fields.size() > core::kMaxFields) {
    loaded.warnings.push_back("the body has " + std::to_string(loaded.fields.size()) + " fields; " +
                              std::to_string(loaded.fields.size() - core::kMaxFields) +
                              " of them are left out: at most " + std::to_string(core::kMaxFields) +
                              " are carried");
    loaded.fields.resize(core::kMaxFields);
  }
}

}  // namespace

std::vector<core::Field> declared_fields(const Config& config, const std::string& file) {
  std::vector<core::Field> fields;
  for (const std::string& text : config.mesh.fields) {
    core::Field field;
    bool fits = true, has_count = false;
    std::size_t at = text.find(':');
    field.name = text.substr(0, at);
    while (at != std::string::npos) {
      const std::size_t next = text.find(':', at + 1);
      const std::string word = text.substr(at + 1, next == std::string::npos ? next : next - at - 1);
      at = next;
      if (word == "tets") {
        field.on = core::Field::On::kTets;
      } else if (word == "int") {
        field.values.emplace<1>();
      } else if (word.size() == 1 && word[0] >= '2' && word[0] <= '9' && !has_count) {
        field.components = static_cast<std::size_t>(word[0] - '0');
        has_count = true;
      } else {
        fits = false;
      }
    }
    fits = fits && !field.name.empty() && field.name.size() <= core::kMaxFieldName &&
           !mesh_io::has_control_character(field.name);
    for (const core::Field& other : fields)
      fits = fits && !(other.name == field.name && other.on == field.on);
    if (!fits) {
      throw ConfigError(
          (file.empty() ? "" : file + ": ") + "mesh.fields: found " + input::shown(text) +
          "; accepted is a name that no other in the list has, with \":N\" (2 to 9 numbers each), \":tets\" "
          "(on the tetrahedra) and \":int\" behind it");
    }
    fields.push_back(std::move(field));
  }
  return fields;
}

Body load_body(const Config& config, FillProgress progress, bool fields) {
  mesh_io::LoadOptions options = load_options(config, std::move(progress));
  options.fields = fields;
  Body body;
  if (!config.mesh.phantom.empty()) {
    body.name = config.mesh.phantom;
    body.loaded.mesh = mesh_io::make_phantom(*mesh_io::phantom_kind(config.mesh.phantom), options.fill,
                                             body.loaded.warnings);
    body.loaded.hash();
    body.loaded.filled = true;
    if (fields) add_declared(config, body.loaded);
    return body;
  }
  if (config.mesh.path.empty()) {
    throw ConfigError("mesh.path: found \"\"; accepted is a path (or mesh.phantom instead)");
  }
  const std::filesystem::path path = config.resolve(config.mesh.path);
  body.name = path.filename().string();
  body.loaded = mesh_io::load_mesh(path, options);
  if (fields) add_declared(config, body.loaded);
  body.origins = origin_tree(body.loaded.surface.get());
  return body;
}

}  // namespace incise::app
