#pragma once

#include <initializer_list>

#include "server/core/geometry/vec3.hpp"

namespace incise::core {

// A box along the axes, its faces included.
struct Box {
  Vec3 low, high;

  // Around some points, one at least.
  static Box around(std::initializer_list<Vec3> points) {
    Box box{*points.begin(), *points.begin()};
    for (const Vec3& p : points) extend(p, box.low, box.high);
    return box;
  }
  Box widened(double by_m) const {
    const Vec3 by{by_m, by_m, by_m};
    return {low - by, high + by};
  }
  bool has(const Vec3& p) const {
    return p.x >= low.x && p.y >= low.y && p.z >= low.z && p.x <= high.x && p.y <= high.y && p.z <= high.z;
  }
  // Whether p is in it, or beside it within `by_m` along each axis.
  bool has(const Vec3& p, double by_m) const { return widened(by_m).has(p); }
  bool meets(const Box& other) const {
    return low.x <= other.high.x && other.low.x <= high.x && low.y <= other.high.y && other.low.y <= high.y &&
           low.z <= other.high.z && other.low.z <= high.z;
  }
  void add(const Box& other) {
    extend(other.low, low, high);
    extend(other.high, low, high);
  }
};

}  // namespace incise::core
