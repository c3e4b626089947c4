#pragma once

#include <cmath>
#include <cstdint>

#include "server/core/geometry/vec3.hpp"
#include "server/haptics/force_slot.hpp"

namespace incise::input {

inline constexpr std::int64_t kForceLife_ns = 20'000'000;

// The last check before a force goes to a device, whatever the loop says. A command that is older than 20 ms or not finite
// becomes no force and no torque. So does every command after a failed write, until the loop has sent one of no force and so knows of
// the failure. A force or a torque beyond the device's limit is cut to that limit.
//
// Thread: one.
class ForceGuard {
 public:
  explicit ForceGuard(double max_newtons, double max_newton_metres = 0)
      : max_newtons_(max_newtons), max_newton_metres_(max_newton_metres) {}

  // Newtons, world frame. `now_ns` CLOCK_MONOTONIC.
  core::Vec3 pass(const haptics::ForceCommand& newest, std::int64_t now_ns) noexcept {
    const core::Vec3 force{newest.newtons[0], newest.newtons[1], newest.newtons[2]};
    const double size = core::length(force);
    if (size == 0) distrusted_ = false;
    if (!std::isfinite(size) || distrusted_ || now_ns - newest.time_ns > kForceLife_ns) return {};
    return size > max_newtons_ ? (max_newtons_ / size) * force : force;
  }
  // Newton metres, world frame; after pass() of the same command.
  core::Vec3 pass_torque(const haptics::ForceCommand& newest, std::int64_t now_ns) const noexcept {
    const core::Vec3 torque{newest.newton_metres[0], newest.newton_metres[1], newest.newton_metres[2]};
    const double size = core::length(torque);
    if (!std::isfinite(size) || distrusted_ || now_ns - newest.time_ns > kForceLife_ns) return {};
    return size > max_newton_metres_ ? (max_newton_metres_ / size) * torque : torque;
  }
  void failed() noexcept { distrusted_ = true; }

 private:
  const double max_newtons_, max_newton_metres_;
  bool distrusted_ = false;
};

}  // namespace incise::input
