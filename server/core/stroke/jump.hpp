#pragma once

#include <algorithm>
#include <cstdint>

#include "server/core/cut/cut_config.hpp"
#include "server/core/stroke/blade.hpp"

namespace incise::core {

// From one pose to a later one of the same source, by up to 2^64 - 1 ns: more than the signed difference can hold.
inline std::uint64_t elapsed_ns(const Pose& from, const Pose& to) {
  return static_cast<std::uint64_t>(to.t_ns) - static_cast<std::uint64_t>(from.t_ns);
}

// Who was late and stamps poses when it sends them has the next ones a few microseconds apart: times are not taken for nearer than this.
inline constexpr double kNearestTimes_s = 0.001;

// Whether a blade jumped from one pose to a later one instead of moving: after too long a silence, or faster than it may move.
// Strokes, forces and what interpolates poses must agree on that. NaN is a jump.
inline bool is_jump(const CutConfig& config, const Blade& blade, const Pose& from, const Pose& to) {
  const double dt_s = static_cast<double>(elapsed_ns(from, to)) * 1e-9;
  const double step_m = travel(blade_line(blade, from), blade_line(blade, to));
  return !(dt_s <= config.gap_limit_s && step_m <= config.speed_limit_m_s * std::max(dt_s, kNearestTimes_s));
}

}  // namespace incise::core
