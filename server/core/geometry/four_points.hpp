#pragma once

#include <algorithm>
#include <cstddef>

#include "server/core/geometry/vec3.hpp"

namespace incise::core {

// The corners of a tetrahedron, side by side: operations on all four compile to vector instructions and give the same
// bits as one at a time.
struct FourPoints {
  double x[4], y[4], z[4];

  template <class PositionOf>
  explicit FourPoints(PositionOf position_of) {
    for (std::size_t i = 0; i < 4; ++i) {
      const Vec3& p = position_of(i);
      x[i] = p.x;
      y[i] = p.y;
      z[i] = p.z;
    }
  }

  // out[i] = axis . point[i] - offset
  void along(const Vec3& axis, double offset, double (&out)[4]) const {
    for (int i = 0; i < 4; ++i) out[i] = axis.x * x[i] + axis.y * y[i] + axis.z * z[i] - offset;
  }
  // The box around them.
  void bounds(Vec3& low, Vec3& high) const {
    low = {least(x), least(y), least(z)};
    high = {most(x), most(y), most(z)};
  }
  static double least(const double (&v)[4]) { return std::min(std::min(v[0], v[1]), std::min(v[2], v[3])); }
  static double most(const double (&v)[4]) { return std::max(std::max(v[0], v[1]), std::max(v[2], v[3])); }
};

}  // namespace incise::core
