#pragma once

// Small meshes and motions for tests, made here so that they are the same everywhere.

#include <array>
#include <cstdint>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"
#include "server/core/stroke/blade.hpp"

namespace incise::tests {

// The cube [0, size]^3 of n^3 cells, each six tetrahedra around the cell's main diagonal (Kuhn 1960).
inline core::MeshData cube(std::uint32_t n, double size = 0.1) {
  core::MeshData mesh;
  const std::uint32_t m = n + 1;
  for (std::uint32_t z = 0; z < m; ++z) {
    for (std::uint32_t y = 0; y < m; ++y) {
      for (std::uint32_t x = 0; x < m; ++x) {
        mesh.positions.push_back({size * x / n, size * y / n, size * z / n});
      }
    }
  }
  const std::array<std::uint32_t, 3> step{1, m, m * m};
  constexpr int kOrders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
  for (std::uint32_t z = 0; z < n; ++z) {
    for (std::uint32_t y = 0; y < n; ++y) {
      for (std::uint32_t x = 0; x < n; ++x) {
        const std::uint32_t a = x + m * y + m * m * z;
        for (int i = 0; i < 6; ++i) {
          const std::uint32_t b = a + step[kOrders[i][0]], c = b + step[kOrders[i][1]],
                              d = c + step[kOrders[i][2]];
          if (i < 3) {
            mesh.tets.push_back({a, b, c, d});
          } else {
            mesh.tets.push_back({a, c, b, d});
          }
        }
      }
    }
  }
  mesh.regions.assign(mesh.tets.size(), 0);
  return mesh;
}

// A blade that passes through cube() from in front of it (y < 0) to behind, slightly tilted: `count` poses at
// `rate_hz` and 0.2 m/s, engaged by button 0. `x`: where, as a part of the size; `start_ns`: of the first
// pose.
inline std::vector<core::Pose> sweep_through(std::size_t count, double rate_hz = 1000, double x = 0.37,
                                             double size = 0.1, std::int64_t start_ns = 1'000'000'000) {
  std::vector<core::Pose> poses;
  for (std::size_t i = 0; i < count; ++i) {
    core::Pose pose;
    pose.t_ns = start_ns + static_cast<std::int64_t>(1e9 / rate_hz * static_cast<double>(i));
    const double s = static_cast<double>(i) / static_cast<double>(count - 1);
    pose.position = {(x + 0.05 * s) * size, (-0.2 + 1.4 * s) * size, 1.2 * size};
    pose.orientation = {0.9998000066665778, 0.0, 0.01999866669333308, 0.0};  // 0.04 rad about y
    pose.buttons = 1;
    poses.push_back(pose);
  }
  return poses;
}

// The blade of sweep_through(): from above the cube to below it.
inline core::Blade long_blade(double size = 0.1) {
  return {{0, 0, 0}, {0, 0, -1.4 * size}};
}

}  // namespace incise::tests
