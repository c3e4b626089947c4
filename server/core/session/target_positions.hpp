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

  void reserve(std::size_t count) {
    exact_.reserve(count);
    rough_.reserve(count);
  }
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

  // Of four tetrahedra, bit k of tets[k]: whether six volumes of it are surely at least `thick`; where it says no, the exact positions tell.
  unsigned surely_thick(const std::array<VertexId, 4>* tets) const {
    const Four a = corners(tets, 0);
    const Four b = corners(tets, 1) - a, c = corners(tets, 2) - a, d = corners(tets, 3) - a;
    const Lanes volumes =
        (b.y * c.z - b.z * c.y) * d.x + (b.z * c.x - b.x * c.z) * d.y + (b.x * c.y - b.y * c.x) * d.z;
    const Lanes edges = b.squared() + c.squared() + d.squared();
    // What is not a number compares as false.
    const auto thick = (volumes >= rough_thick_) & (edges <= rough_edges_);
    return (static_cast<unsigned>(thick[0]) & 1) | (static_cast<unsigned>(thick[1]) & 2) |
           (static_cast<unsigned>(thick[2]) & 4) | (static_cast<unsigned>(thick[3]) & 8);
  }
  bool surely_thick(const std::array<VertexId, 4>& v) const {
    const std::array<VertexId, 4> four[4] = {v, v, v, v};
    return surely_thick(four) != 0;
  }

 private:
  using Lanes [[gnu::vector_size(16)]] = float;     // x, y, z and nothing, m from origin_
  static constexpr double kUnit = 1.0 / (1 << 24);  // of the rounding of a float

  // Points of four tetrahedra.
  struct Four {
    Lanes x, y, z;
    friend Four operator-(const Four& p, const Four& q) { return {p.x - q.x, p.y - q.y, p.z - q.z}; }
    Lanes squared() const { return x * x + y * y + z * z; }
  };
  Four corners(const std::array<VertexId, 4>* tets, std::size_t corner) const {
    const Lanes p = rough_[tets[0][corner]], q = rough_[tets[1][corner]], r = rough_[tets[2][corner]],
                s = rough_[tets[3][corner]];
    const Lanes pq = __builtin_shufflevector(p, q, 0, 4, 1, 5),
                rs = __builtin_shufflevector(r, s, 0, 4, 1, 5);
    return {__builtin_shufflevector(pq, rs, 0, 1, 4, 5), __builtin_shufflevector(pq, rs, 2, 3, 6, 7),
            __builtin_shufflevector(__builtin_shufflevector(p, q, 2, 6, 3, 7),
                                    __builtin_shufflevector(r, s, 2, 6, 3, 7), 0, 1, 4, 5)};
  }

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
