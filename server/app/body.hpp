#pragma once

#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "protocol/surface_asset.hpp"
#include "server/app/config.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/mesh_io/mesh_io.hpp"

namespace incise::app {

// The mesh that a configuration names, file or phantom, and its name in messages.
struct Body {
  mesh_io::LoadedMesh loaded;
  std::string name;
  std::shared_ptr<const protocol::OriginTree> origins = {};  // of loaded.surface; null without it
  // What sessions of it begin with, where there are to be several. Null: each is made of loaded.mesh.
  std::shared_ptr<const core::LoadedBody> built = {};

  // A session of it as loaded, with its fields. O(mesh).
  std::unique_ptr<core::CutSession> session(const core::CutConfig& cut) const;
};

using FillProgress = std::function<void(std::string_view stage, double seconds)>;

// How the configuration wants a file read. `progress` is called while a surface is filled.
mesh_io::LoadOptions load_options(const Config& config, FillProgress progress = {});

// The fields that mesh.fields declares, without values. Throws ConfigError.
std::vector<core::Field> declared_fields(const Config& config, const std::string& file);

// Checks the mesh that the configuration names, but does not fill a surface, which may take minutes: reads and repairs
// tetrahedra, reads and checks a surface; also how it looks. `file` is the configuration in messages. Returns what the start would warn of, but for
// what only filling shows. Throws ConfigError.
std::vector<std::string> check_body(const Config& config, const std::string& file);

// Whether blades can cut the body: it is not beyond where poses may be, and none of the configuration's is more than 100 times as long as it. Throws ConfigError;
// `file`: as above.
void check_cuttable(const Config& config, const core::MeshData& body, const std::string& file);

// Throws ConfigError if neither mesh.path nor mesh.phantom is given, MeshError if the mesh cannot be read or made.
// `fields`: with the file's fields, and those that the configuration declares.
Body load_body(const Config& config, FillProgress progress = {}, bool fields = false);

}  // namespace incise::app
