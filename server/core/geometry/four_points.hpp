#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstring>

#include "server/core/geometry/vec3.hpp"

namespace incise::core {

// Some points, side by side: operations on all of them compile to vector instructions and give the same bits as one at a time.
template <std::size_t N>
struct Points {
  double x[N], y[N], z[N];

  explicit Points(const std::array<Vec3, N>& points) {
    for (std::size_t i = 0; i < N; ++i) {
      x[i] = points[i].x;
      y[i] = points[i].y;
      z[i] = points[i].z;
    }
  }

  // out[i] = axis . point[i] - offset
  void along(const Vec3& axis, double offset, double (&out)[N]) const {
    for (std::size_t i = 0; i < N; ++i) out[i] = axis.x * x[i] + axis.y * y[i] + axis.z * z[i] - offset;
  }
  static double least(const double (&v)[N]) {
    if constexpr (N == 4) return std::min(std::min(v[0], v[1]), std::min(v[2], v[3]));
    return *std::min_element(v, v + N);
  }
  static double most(const double (&v)[N]) {
    if constexpr (N == 4) return std::max(std::max(v[0], v[1]), std::max(v[2], v[3]));
    return *std::max_element(v, v + N);
  }
  // Bit i: v[i] is at least a bound.
  static unsigned from(const double (&v)[N], double bound) {
#if defined(__SSE2__)
    if constexpr (N == 4) {
      using Pair = double __attribute__((vector_size(16)));
      const auto pair = [&](std::size_t i) {
        Pair at;
        std::memcpy(&at, v + i, sizeof at);
        return static_cast<unsigned>(__builtin_ia32_movmskpd(reinterpret_cast<Pair>(at >= bound)));
      };
      return pair(0) | pair(2) << 2;
    }
#endif
    unsigned bits = 0;
    for (unsigned i = 0; i < N; ++i) bits |= (v[i] >= bound ? 1u : 0u) << i;
    return bits;
  }
  // The least absolute value.
  static double nearest(const double (&v)[N]) {
    double to_zero[N];
    for (std::size_t i = 0; i < N; ++i) to_zero[i] = std::abs(v[i]);
    return least(to_zero);
  }
};

// The corners of a tetrahedron.
using FourPoints = Points<4>;

}  // namespace incise::core
