#include "server/app/stream_output.hpp"

namespace incise::app {
namespace {

protocol::Vec3 to_protocol(const core::Vec3& p) {
  return {p.x, p.y, p.z};
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
  // A latched-off force is off at the operator, too.
  if (force.feel.contact && !message.latched_off) {
    const haptics::ContactPlane& plane = *force.feel.contact;
    message.contact = protocol::LocalContact{
        to_protocol(plane.point), to_protocol(plane.normal), plane.stiffness_n_m, plane.damping_n_s_m,
        plane.resistance_n,       plane.friction_n_s_m,      valid_ns_,           plane.penetrated};
  }
  server_.publish_force(message);
}

}  // namespace incise::app
