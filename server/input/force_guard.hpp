#pragma once

#include <cmath>
#include <cstdint>

#include "server/core/geometry/vec3.hpp"
#include "server/haptics/force_slot.hpp"

namespace incise::input {

inline constexpr std::int64_t kForceLife_ns = 20'000'000;

// The last check before a force goes to a device, whatever the loop says. A command that is older than 20 ms or not finite
// becomes no force. So does every command after a failed write, until the loop has sent one of no force and so knows of
// the failure. A force beyond the device's limit is cut to that limit.
//
// Thread: one.
class ForceGuard {
 public:
  explicit ForceGuard(double max_newtons) : max_newtons_(max_newtons) {}

  // Newtons, world frame. `now_ns` CLOCK_MONOTONIC.
  core::Vec3 pass(const haptics::ForceCommand& newest, std::int64_t now_ns) noexcept {
    const core::Vec3 force{newest.newtons[0], newest.newtons[1], newest.newtons[2]};
    const double size = core::length(force);
    if (size == 0) distrusted_ = false;
    if (!std::isfinite(size) || distrusted_ || now_ns - newest.time_ns > kForceLife_ns) return {};
    return size > max_newtons_ ? (max_newtons_ / size) * force : force;
  }
  void failed() noexcept { distrusted_ = true; }

 private:
  const double max_newtons_;
  bool distrusted_ = false;
};

}  // namespace incise::input
