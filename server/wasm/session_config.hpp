#pragma once

#include <string>
#include <vector>

#include "server/core/cut/cut_config.hpp"

namespace incise::wasm {

// What a session needs of a configuration.
struct SessionConfig {
  core::CutConfig cut;
  std::vector<core::Blade> blades;  // of the first sources; the others have cut.blade
};

// From the configuration in a capture's header, which incised or incise wrote with all its keys; the sections that a session does not
// need are not looked at. `name` is the capture in messages. Throws std::runtime_error: one line.
SessionConfig session_config(const std::string& json, const std::string& name);

}  // namespace incise::wasm
