#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "server/core/geometry/vec3.hpp"
#include "server/core/mesh/tet_mesh.hpp"

namespace incise::core {

// Where each vertex will lie after a step of a host simulation, and the same in 32 bits, which is enough to see of nearly every
// tetrahedron that it is thick, at half the cost: a step looks at all of them, and their vertices lie anywhere in memory.
class TargetPositions {
 public:
  std::size_t size() const { return exact_.size(); }
  const Vec3& operator[](VertexId v) const { return exact_[v]; }
  const std::vector<Vec3>& by_vertex() const { return exact_; }

  // p must be finite.
  void push_back(const Vec3& p) {
    if (exact_.empty()) origin_ = p;
    exact_.push_back(p);
    rough_.push_back(rounded(p));
  }
  void set(VertexId v, const Vec3& p) {
    exact_[v] = p;
    rough_[v] = rounded(p);
  }
  void prefetch(VertexId v) const { __builtin_prefetch(&rough_[v]); }

  // Call before surely_thick() and after the last set(). `thick`: six volumes, m^3. `edge`: surely_thick() says no of a tetrahedron
  // with much longer ones, m.
  void begin_looking(double thick, double edge) {
    // Of a difference of two coordinates, each rounded; then of the determinant of three such vectors, each at most `edge` long:
    // from the vectors' errors, and from its own arithmetic. Twice that is certain to be enough.
    const double difference = kUnit * (2 * farthest_ + edge);
    const double error = (6 * difference + 16 * kUnit * edge) * edge * edge;
    rough_thick_ = static_cast<float>((thick + 2 * error) * (1 + kUnit));
    rough_edges_ = static_cast<float>(edge * edge * (1 - 16 * kUnit));
  }

  // Whether six volumes of this tetrahedron are surely at least `thick`; where it says no, the exact positions tell.
  bool surely_thick(const std::array<VertexId, 4>& v) const {
    const Lanes a = rough_[v[0]];
    const Lanes b = rough_[v[1]] - a, c = rough_[v[2]] - a, d = rough_[v[3]] - a;
    const Lanes cross = yzx(b) * zxy(c) - zxy(b) * yzx(c);
    const Lanes volume = cross * d;
    const Lanes edges = b * b + c * c + d * d;
    // Both sums at once: of x and z, then with y.
    const Lanes both = __builtin_shufflevector(volume, edges, 0, 4, 2, 6);
    const Lanes sums = both + __builtin_shufflevector(both, both, 2, 3, 2, 3) +
                       __builtin_shufflevector(volume, edges, 1, 5, 1, 5);
    // What is not a number compares as false.
    return sums[0] >= rough_thick_ && sums[1] <= rough_edges_;
  }

 private:
  using Lanes [[gnu::vector_size(16)]] = float;     // x, y, z and nothing, m from origin_
  static constexpr double kUnit = 1.0 / (1 << 24);  // of the rounding of a float

  static Lanes yzx(Lanes p) { return __builtin_shufflevector(p, p, 1, 2, 0, 3); }
  static Lanes zxy(Lanes p) { return __builtin_shufflevector(p, p, 2, 0, 1, 3); }

  Lanes rounded(const Vec3& p) {
    const Vec3 from = p - origin_;
    farthest_ = std::max({farthest_, std::abs(from.x), std::abs(from.y), std::abs(from.z)});
    return Lanes{static_cast<float>(from.x), static_cast<float>(from.y), static_cast<float>(from.z), 0};
  }

  std::vector<Vec3> exact_;
  std::vector<Lanes> rough_;
  Vec3 origin_;          // the first vertex's first place
  double farthest_ = 0;  // any coordinate from there, ever
  float rough_thick_ = 0, rough_edges_ = 0;
};

}  // namespace incise::core
