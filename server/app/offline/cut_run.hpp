#pragma once

#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "server/app/config.hpp"
#include "server/app/offline/motion_run.hpp"
#include "server/app/offline/recorded_motion.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/mesh_io/mesh_io.hpp"

namespace incise::app {

// A body cut by a motion, and the report on it: what `incise cut` and the Python module do.

// What is cut, and by what. Made by cut_input().
struct CutInput {
  std::string mesh_name, poses_name;  // in the report and in warnings
  RecordedMotion motion;
  Config config;
  std::shared_ptr<const mesh_io::LoadedMesh> loaded;
  Box body;
  std::string raised_limits;
  std::vector<std::string> warnings;
};
// When the blade is engaged.
enum class Engage {
  kAlways,
  kConfigured  // as the configuration says; a motion without buttons holds the one that engages
};
// Limits are raised to suit the motion. Throws std::runtime_error if a blade is much too long for the body.
CutInput cut_input(std::string mesh_name, std::string poses_name, RecordedMotion motion, Config config,
                   std::shared_ptr<const mesh_io::LoadedMesh> loaded, Engage engage = Engage::kAlways);

// Gives every source this blade, whatever the configuration or the capture says.
void set_blade(const core::Blade& blade, Config& config, RecordedMotion& motion);

// "no-growth", "balanced" or "exact", as the configuration has it.
const char* name_of(core::Preference prefer);

// Called while a motion is cut: after each event of it, and for each batch.
struct CutHooks {
  std::function<void(const core::CutSession&, const MotionEvent&)> event;
  std::function<void(const core::CutSession&, const core::Delta&)> commit;
};

struct CutOutcome {
  std::unique_ptr<core::CutSession> session;  // with the mesh file's fields
  nlohmann::ordered_json report;
};
// Cuts the mesh by the motion, in the same way as the server. `config` is in.config, or that with another policy.
CutOutcome cut(const CutInput& in, const Config& config, Progress& progress, const CutHooks& hooks = {});

}  // namespace incise::app
