#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "server/core/geometry/vec3.hpp"

namespace incise::core {

// A rotation, as a unit quaternion (Hamilton convention: v' = q v q*).
struct Quat {
  double w = 1, x = 0, y = 0, z = 0;

  Quat normalized() const {
    const double length = std::sqrt(w * w + x * x + y * y + z * z);
    return {w / length, x / length, y / length, z / length};
  }
  friend bool operator==(const Quat&, const Quat&) = default;
};

// The vector v turned by q. q must be of unit length.
inline Vec3 rotate(const Quat& q, const Vec3& v) {
  const Vec3 u{q.x, q.y, q.z};
  const Vec3 t = 2.0 * cross(u, v);
  return v + q.w * t + cross(u, t);
}

// The rotation b, and then a.
inline Quat product(const Quat& a, const Quat& b) {
  const Vec3 u{a.x, a.y, a.z}, v{b.x, b.y, b.z};
  const Vec3 w = a.w * v + b.w * u + cross(u, v);
  return {a.w * b.w - dot(u, v), w.x, w.y, w.z};
}

// Where the tool was: world_from_tool at one moment of the source's own clock.
struct Pose {
  std::int64_t t_ns = 0;      // source time
  Vec3 position;              // metres, world frame
  Quat orientation;           // unit
  std::uint32_t buttons = 0;  // bit i: button i is held

  friend bool operator==(const Pose&, const Pose&) = default;
};

// The cutting edge: a segment in the tool's frame, metres.
struct Blade {
  Vec3 heel{0, 0, 0};
  Vec3 tip{0, 0, -0.05};

  friend bool operator==(const Blade&, const Blade&) = default;
};

// The cutting edge in the world frame.
struct BladeLine {
  Vec3 heel;
  Vec3 tip;

  friend bool operator==(const BladeLine&, const BladeLine&) = default;
};

inline BladeLine blade_line(const Blade& blade, const Pose& world_from_tool) {
  return {world_from_tool.position + rotate(world_from_tool.orientation, blade.heel),
          world_from_tool.position + rotate(world_from_tool.orientation, blade.tip)};
}

// How far the blade has moved between two lines: the longer of its ends' ways, m.
inline double travel(const BladeLine& a, const BladeLine& b) {
  return std::max(distance(a.heel, b.heel), distance(a.tip, b.tip));
}

}  // namespace incise::core
