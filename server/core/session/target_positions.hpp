#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
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
    note_extent(p, p);
  }
  void set(VertexId v, const Vec3& p) {
    exact_[v] = p;
    rough_[v] = rounded(p);
    note_extent(p, p);
  }
  // The same for several; all lie between `low` and `high`.
  void set(std::span<const VertexId> vertices, std::span<const Vec3> places, const Vec3& low,
           const Vec3& high) {
    if (vertices.empty()) return;
    for (std::size_t i = 0; i < vertices.size(); ++i) {
      exact_[vertices[i]] = places[i];
      rough_[vertices[i]] = rounded(places[i]);
    }
    note_extent(low, high);
  }

  // How it looks at some tetrahedra; all ways find the same.
  using Look = std::uint64_t (*)(const TargetPositions&, const std::array<VertexId, 4>*, std::size_t,
                                 std::size_t);
  static std::uint64_t look_anywhere(const TargetPositions& at, const std::array<VertexId, 4>* tets,
                                     std::size_t count, std::size_t then) {
    return at.look(tets, count, then);
  }
#if defined(__x86_64__)
  [[gnu::target("avx2")]] static std::uint64_t look_with_avx2(const TargetPositions& at,
                                                              const std::array<VertexId, 4>* tets,
                                                              std::size_t count, std::size_t then) {
    return at.look(tets, count, then);
  }
  static Look fastest() {
    return __builtin_cpu_supports("avx2") ? look_with_avx2 : look_anywhere;
  }
#else
  static Look fastest() {
    return look_anywhere;
  }
#endif

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

  // Bit k: whether six volumes of the k-th of `count` tetrahedra, at most 64, are surely at least `thick`; where it says no, the exact
  // positions tell. Those beyond a multiple of eight are not looked at: no.
  // `then`: so many follow them that are looked at next. Between two frames others use the caches, so what comes is fetched ahead.
  std::uint64_t surely_thick(const std::array<VertexId, 4>* tets, std::size_t count, std::size_t then = 0,
                             Look how = fastest()) const {
    return how(*this, tets, count, then);
  }

 private:
  static constexpr std::size_t kLanes = 8;
  static constexpr std::size_t kAhead = 3 * kLanes;  // tetrahedra, of what is to be fetched
  using Place [[gnu::vector_size(16)]] = float;      // x, y, z and nothing, m from origin_
  using Lanes [[gnu::vector_size(4 * kLanes)]] = float;
  using Bits [[gnu::vector_size(4 * kLanes)]] = std::int32_t;
  static constexpr double kUnit = 1.0 / (1 << 24);  // of the rounding of a float

  [[gnu::always_inline]] inline std::uint64_t look(const std::array<VertexId, 4>* tets, std::size_t count,
                                                   std::size_t then) const {
    std::uint64_t thick = 0;
    for (std::size_t i = 0; i + kLanes <= count; i += kLanes) {
      if (i + kAhead + kLanes <= count + then) {
        for (std::size_t k = i + kAhead; k < i + kAhead + kLanes; ++k)
          for (const VertexId v : tets[k]) __builtin_prefetch(&rough_[v]);
      }
      thick |= std::uint64_t{look_at_some(tets + i)} << i;
    }
    return thick;
  }

  // The same corner of eight tetrahedra.
  struct Points {
    Lanes x, y, z;
  };
  [[gnu::always_inline]] inline void corners(const std::array<VertexId, 4>* tets, std::size_t corner,
                                             Points& out) const {
    Lanes two[4];  // rows, of the k-th tetrahedron and of the one four after it
    for (std::size_t k = 0; k < 4; ++k) {
      two[k] = __builtin_shufflevector(rough_[tets[k][corner]], rough_[tets[k + 4][corner]], 0, 1, 2, 3, 4, 5,
                                       6, 7);
    }
    const auto& [p, q, r, s] = two;
    const Lanes pq = __builtin_shufflevector(p, q, 0, 8, 1, 9, 4, 12, 5, 13),
                rs = __builtin_shufflevector(r, s, 0, 8, 1, 9, 4, 12, 5, 13);
    out.x = __builtin_shufflevector(pq, rs, 0, 1, 8, 9, 4, 5, 12, 13);
    out.y = __builtin_shufflevector(pq, rs, 2, 3, 10, 11, 6, 7, 14, 15);
    out.z = __builtin_shufflevector(__builtin_shufflevector(p, q, 2, 10, 3, 11, 6, 14, 7, 15),
                                    __builtin_shufflevector(r, s, 2, 10, 3, 11, 6, 14, 7, 15), 0, 1, 8, 9, 4,
                                    5, 12, 13);
  }

  // Bit k: whether the k-th of eight is surely thick.
  [[gnu::always_inline]] inline unsigned look_at_some(const std::array<VertexId, 4>* tets) const {
    Points a, b, c, d;
    corners(tets, 0, a);
    corners(tets, 1, b);
    corners(tets, 2, c);
    corners(tets, 3, d);
    for (Points* p : {&b, &c, &d}) {
      p->x -= a.x;
      p->y -= a.y;
      p->z -= a.z;
    }
    const Lanes volumes =
        (b.y * c.z - b.z * c.y) * d.x + (b.z * c.x - b.x * c.z) * d.y + (b.x * c.y - b.y * c.x) * d.z;
    const Lanes edges = b.x * b.x + b.y * b.y + b.z * b.z + (c.x * c.x + c.y * c.y + c.z * c.z) +
                        (d.x * d.x + d.y * d.y + d.z * d.z);
    // What is not a number compares as false.
    const Bits bits = (volumes >= rough_thick_) & (edges <= rough_edges_) & Bits{1, 2, 4, 8, 16, 32, 64, 128};
    int all = 0;
    for (std::size_t k = 0; k < kLanes; ++k) all |= bits[k];
    return static_cast<unsigned>(all);
  }

  Place rounded(const Vec3& p) const {
    const Vec3 from = p - origin_;
    return Place{static_cast<float>(from.x), static_cast<float>(from.y), static_cast<float>(from.z), 0};
  }
  void note_extent(const Vec3& low, const Vec3& high) {
    const Vec3 a = low - origin_, b = high - origin_;
    farthest_ = std::max({farthest_, std::abs(a.x), std::abs(a.y), std::abs(a.z), std::abs(b.x),
                          std::abs(b.y), std::abs(b.z)});
  }

  std::vector<Vec3> exact_;
  std::vector<Place> rough_;
  Vec3 origin_;          // the first vertex's first place
  double farthest_ = 0;  // any coordinate from there, ever
  float rough_thick_ = 0, rough_edges_ = 0;
};

}  // namespace incise::core
