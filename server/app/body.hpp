#pragma once

#include <functional>
#include <string>
#include <string_view>

#include "server/app/config.hpp"
#include "server/mesh_io/mesh_io.hpp"

namespace incise::app {

// The mesh that a configuration names, file or phantom, and what it is called in messages.
struct Body {
  mesh_io::LoadedMesh loaded;
  std::string name;
};

using FillProgress = std::function<void(std::string_view stage, double seconds)>;

// How the configuration wants a file read. `progress` is called while a surface is filled.
mesh_io::LoadOptions load_options(const Config& config, FillProgress progress = {});

// Looks at the mesh that the configuration `file` names as far as can be without filling it, which may take minutes: reads
// and repairs tetrahedra, reads and checks a surface. Throws ConfigError.
void check_body(const Config& config, const std::string& file);

// Throws ConfigError where neither mesh.path nor mesh.phantom is given, MeshError where it cannot be read or made.
Body load_body(const Config& config, FillProgress progress = {});

}  // namespace incise::app
