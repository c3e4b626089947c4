#include "server/app/body.hpp"

#include <exception>

#include "server/app/surface_asset.hpp"
#include "server/mesh_io/phantom.hpp"

namespace incise::app {

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

void check_body(const Config& config, const std::string& file) {
  if (config.mesh.path.empty()) return;
  try {
    mesh_io::check_mesh(config.resolve(config.mesh.path), load_options(config));
  } catch (const std::exception& error) {
    throw ConfigError(file + ": mesh.path: " + error.what());
  }
}

Body load_body(const Config& config, FillProgress progress, bool fields) {
  mesh_io::LoadOptions options = load_options(config, std::move(progress));
  options.fields = fields;
  Body body;
  if (!config.mesh.phantom.empty()) {
    body.name = config.mesh.phantom;
    body.loaded.mesh = mesh_io::make_phantom(*mesh_io::phantom_kind(config.mesh.phantom), options.fill,
                                             body.loaded.warnings);
    body.loaded.content_hash = mesh_io::mesh_hash(body.loaded.mesh);
    body.loaded.filled = true;
    return body;
  }
  if (config.mesh.path.empty()) {
    throw ConfigError("mesh.path: found \"\"; accepted is a path (or mesh.phantom instead)");
  }
  const std::filesystem::path path = config.resolve(config.mesh.path);
  body.name = path.filename().string();
  body.loaded = mesh_io::load_mesh(path, options);
  body.origins = origin_tree(body.loaded.surface.get());
  return body;
}

}  // namespace incise::app
