#pragma once

#include <algorithm>
#include <array>
#include <cstddef>

#include "server/core/geometry/vec3.hpp"

namespace incise::core {

// The corners of a tetrahedron, side by side: operations on all four compile to vector instructions and give the same
// bits as one at a time.
struct FourPoints {
  double x[4], y[4], z[4];

  explicit FourPoints(const std::array<Vec3, 4>& points) {
    for (std::size_t i = 0; i < 4; ++i) {
      x[i] = points[i].x;
      y[i] = points[i].y;
      z[i] = points[i].z;
    }
  }

  // out[i] = axis . point[i] - offset
  void along(const Vec3& axis, double offset, double (&out)[4]) const {
    for (int i = 0; i < 4; ++i) out[i] = axis.x * x[i] + axis.y * y[i] + axis.z * z[i] - offset;
  }
  static double least(const double (&v)[4]) { return std::min(std::min(v[0], v[1]), std::min(v[2], v[3])); }
  static double most(const double (&v)[4]) { return std::max(std::max(v[0], v[1]), std::max(v[2], v[3])); }
};

}  // namespace incise::core
