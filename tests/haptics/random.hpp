#pragma once

#include <cstdint>

#include "server/core/geometry/vec3.hpp"
#include "server/core/mesh/mesh_data.hpp"

namespace incise::tests {

// Random numbers that are the same everywhere (Steele, Lea and Flood 2014, "SplitMix"). Tests print the seed.
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}
  std::uint64_t next() {
    std::uint64_t z = (state_ += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
  }
  std::uint32_t below(std::uint32_t n) { return static_cast<std::uint32_t>(next() % n); }
  double uniform(double low, double high) {
    return low + (high - low) * (static_cast<double>(next() >> 11) * 0x1p-53);
  }
  core::Vec3 in_box(const core::Vec3& low, const core::Vec3& high) {
    const double x = uniform(low.x, high.x), y = uniform(low.y, high.y), z = uniform(low.z, high.z);
    return {x, y, z};
  }

 private:
  std::uint64_t state_;
};

// Thin tetrahedra across the x axis, none of which touches another.
inline core::MeshData comb(std::uint32_t teeth) {
  core::MeshData mesh;
  for (std::uint32_t i = 0; i < teeth; ++i) {
    const double x = 1e-4 * i;
    mesh.positions.insert(mesh.positions.end(), {{x, -1, -1}, {x, 1, -1}, {x, 0, 1}, {x + 5e-5, 0, 0}});
    mesh.tets.push_back({4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 3});
  }
  return mesh;
}

}  // namespace incise::tests
