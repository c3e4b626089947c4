#pragma once

#include "server/core/stroke/blade.hpp"

namespace incise::input {

// Where a device's workspace lies in the world: p_world = origin + rotation * (scale * p), after the profile's own axes
// and scale. For a tool whose pose is integrated this places its start.
struct Placement {
  core::Vec3 origin;
  core::Quat rotation;
  double scale = 1;

  friend bool operator==(const Placement&, const Placement&) = default;
};

inline core::Vec3 world_from_device(const Placement& placement, const core::Vec3& point) {
  return placement.origin + core::rotate(placement.rotation, placement.scale * point);
}

// A direction or force in the device's axes: rotated, not scaled.
inline core::Vec3 turned_to_device(const Placement& placement, const core::Vec3& v) {
  const core::Quat& q = placement.rotation;
  return core::rotate({q.w, -q.x, -q.y, -q.z}, v);
}

inline core::Vec3 device_from_world(const Placement& placement, const core::Vec3& point) {
  return (1 / placement.scale) * turned_to_device(placement, point - placement.origin);
}

// A rotation measured by the device, in the world.
inline core::Quat world_from_device(const Placement& placement, const core::Quat& b) {
  const core::Quat& a = placement.rotation;
  return {a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
          a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}

}  // namespace incise::input
