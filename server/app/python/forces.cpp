#include "server/app/python/forces.hpp"

#include <memory>

namespace incise::python {
namespace {

haptics::ForceConfig without_limits(haptics::ForceConfig config) {
  constexpr double kNone = 1e12;
  config.limits = {
      .most_n = kNone, .slew_n_s = kNone * kNone, .ramp_s = 1e-6, .silence_s = kNone, .frozen_s = kNone};
  return config;
}

}  // namespace

ForceTrace::ForceTrace(const app::Config& config, const core::MeshData& mesh)
    : stage_(without_limits(config.haptics.force), config.cut, std::make_unique<haptics::Tissue>(mesh), this,
             nullptr) {}

void ForceTrace::feel(const haptics::BladeForce& force) noexcept {
  if (force.source == source_) force_ = force.feel.force;
}

void ForceTrace::event(const app::Config& config, const app::MotionEvent& event) {
  using Kind = app::MotionEvent::Kind;
  const bool opens = event.kind == Kind::kOpened;
  if (opens || (event.kind == Kind::kPose && (opened_ >> event.source & 1u) == 0)) {
    stage_.opened(event.source, opens && event.blade ? *event.blade : app::blade_of(config, event.source));
    opened_ |= 1u << event.source;
  }
  if (event.kind != Kind::kPose) return;
  source_ = event.source;
  force_ = {};
  if (core::is_finite(event.pose.position)) {  // a capture also has poses that were rejected
    stage_.posed(event.source, event.pose, event.pose.t_ns, false);
    stage_.frame(event.pose.t_ns, 0);
  }
  forces_.push_back(force_);
}

void ForceTrace::commit(const core::CutSession& session, const core::Delta& delta) {
  stage_.cut(session.mesh(), delta);
}

}  // namespace incise::python
