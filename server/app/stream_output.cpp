#include "server/app/stream_output.hpp"

#include <algorithm>

#include "server/base/clock.hpp"
#include "server/replay/session_view.hpp"

namespace incise::app {
namespace {

using replay::to_protocol;

constexpr std::int64_t kStale_ns = 1'000'000'000;

// Leaves what it names; nothing acts.
void clear(haptics::BladeLoad& load) {
  load.contact = haptics::ContactState::kNone;
  load.engaged = false;
  load.force = load.torque = {};
  load.engaged_m = 0;
  load.loads.count = 0;
}

}  // namespace

void ForceOutput::feel(const haptics::BladeForce& force) noexcept {
  protocol::Force message;
  message.source = force.source;
  message.source_ns = force.pose_t_ns;
  message.force_n = to_protocol(force.newtons);
  message.engaged_length_m = force.feel.engagement.length_m;
  message.saturated = (force.flags & haptics::kForceLimited) != 0;
  message.ramping = (force.flags & haptics::kForceRamping) != 0;
  message.latched_off = (force.flags & haptics::kForceLatchedOff) != 0;
  if (torques_) message.torque_n_m = to_protocol(force.newton_metres);
  // A latched-off force is off at the operator, too.
  if (force.feel.contact && !message.latched_off) {
    const haptics::ContactPlane& plane = *force.feel.contact;
    message.contact = protocol::LocalContact{
        to_protocol(plane.point),   to_protocol(plane.normal), plane.stiffness_n_m, plane.damping_n_s_m,
        plane.resistance_n,         plane.friction_n_s_m,      valid_ns_,           plane.penetrated,
        to_protocol(force.feel.arm)};
  }
  server_.publish_force(message);
}

std::span<const protocol::BladeLoad> SimulationOutput::loads() {
  const std::int64_t now_ns = monotonic_ns();
  link_.wanted_until_ns.store(now_ns + 1'000'000'000, std::memory_order_relaxed);
  messages_.clear();
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source) {
    haptics::BladeLoad& load = newest_[source];
    if (link_.loads[source].read(load)) {
      for (std::size_t i = 0; i < load.loads.count; ++i) {
        forces_[source][3 * i] = load.loads.forces[i].x;
        forces_[source][3 * i + 1] = load.loads.forces[i].y;
        forces_[source][3 * i + 2] = load.loads.forces[i].z;
      }
    }
    if (load.number == 0) continue;
    // From before anyone asked again: the loop goes on writing while something acts.
    if (now_ns - load.now_ns > kStale_ns) clear(load);
    protocol::BladeLoad message;
    message.source = source;
    message.revision = load.revision;
    message.source_ns = load.pose_t_ns;
    message.server_ns = load.now_ns;
    message.contact = static_cast<protocol::BladeContact>(load.contact);
    message.engaged = load.engaged;
    message.heel = to_protocol(load.line.heel);
    message.tip = to_protocol(load.line.tip);
    message.tool = to_protocol(load.tool);
    message.force_n = to_protocol(load.force);
    message.torque_n_m = to_protocol(load.torque);
    message.center = to_protocol(load.loads.center);
    message.engaged_length_m = load.engaged_m;
    message.ids = std::span(load.loads.ids).first(load.loads.count);
    message.forces = std::span(forces_[source]).first(3 * load.loads.count);
    message.number = load.number;
    messages_.push_back(message);
  }
  return messages_;
}

std::string SimulationOutput::use(const protocol::BladeModel& model) {
  if (model.source >= core::kMaxSources) return "there is no such blade";
  if (model.stiffness.size() != 9)
    return "stiffness of " + std::to_string(model.stiffness.size()) + " numbers; accepted are 9";
  const auto to_core = [](const protocol::Vec3& p) { return core::Vec3{p.x, p.y, p.z}; };
  const auto row = [&](std::size_t i) {
    return core::Vec3{model.stiffness[3 * i], model.stiffness[3 * i + 1], model.stiffness[3 * i + 2]};
  };
  haptics::LocalModel local;
  local.number = ++models_;
  local.point = to_core(model.point);
  local.normal = to_core(model.normal);
  local.stiffness = {row(0), row(1), row(2)};  // symmetric, or it is refused
  local.damping_n_s_m = model.damping_n_s_per_m;
  local.resistance_n = model.resistance_n;
  local.from_ns = model.server_ns;
  // So that no sum overflows: what is longer is refused anyway.
  const std::int64_t valid_ns = std::clamp<std::int64_t>(model.valid_for_ns, -1, 2'000'000'000);
  const std::int64_t now_ns = monotonic_ns();
  if (model.server_ns < 0 || model.server_ns > now_ns) return "it answers a BladeLoad of the future";
  local.expires_ns = model.server_ns + valid_ns;
  std::string trouble = haptics::trouble_of(local, now_ns);
  if (trouble.empty()) link_.models[model.source].write(local);
  return trouble;
}

}  // namespace incise::app
