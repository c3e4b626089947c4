#pragma once

#include <vector>

#include "server/app/config.hpp"
#include "server/app/offline/recorded_motion.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/haptics/force_stage.hpp"

namespace incise::python {

// The contact model's force for each pose of a motion, by the server's force stage without its limits: no clamp, slew or
// ramp, which depend on when frames come.
//
// Thread: one, at a time. Owns a copy of the body as loaded.
class ForceTrace : private haptics::ForceSink {
 public:
  ForceTrace(const app::Config& config, const core::MeshData& mesh);

  void begin() { forces_.clear(); }
  void event(const app::Config& config, const app::MotionEvent& event);
  void commit(const core::CutSession& session, const core::Delta& delta);
  // On the hand at the tool's origin, N: one for each pose.
  std::vector<core::Vec3> take() { return std::move(forces_); }

 private:
  void feel(const haptics::BladeForce& force) noexcept override;

  haptics::ForceStage stage_;
  std::uint32_t opened_ = 0;  // bit i: source i is
  std::uint32_t source_ = 0;  // whose force is wanted
  core::Vec3 force_;
  std::vector<core::Vec3> forces_;
};

}  // namespace incise::python
