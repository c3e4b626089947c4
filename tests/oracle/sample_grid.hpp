#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/stroke/blade.hpp"

// A body as points on a fine grid, and what surfaces do to the ways between neighbouring points. It shares nothing with the
// cutters: where a surface runs is decided by intersecting it with the grid's own segments.
namespace incise::oracle {

using core::Vec3;

// A triangle of a surface.
struct Triangle {
  std::array<Vec3, 3> corners;
};

// Points origin + spacing (i, j, k). A point's neighbours are the six next to it.
class SampleGrid {
 public:
  // Covers the box with a margin of two points.
  SampleGrid(const Vec3& low, const Vec3& high, double spacing);

  double spacing() const { return spacing_; }
  std::size_t size() const { return size_; }
  // Point i + count[0] (j + count[1] k); its neighbour along axis a is step(a) farther.
  std::size_t step(int axis) const { return step_[axis]; }
  Vec3 point(std::size_t index) const;

  // Calls visit(index) for each point in the tetrahedron.
  template <class Visit>
  void in_tet(const Vec3 (&p)[4], Visit visit) const;
  // Calls visit(index, axis, where) for each segment from a point along an axis that the triangle crosses. Inclusive at
  // the triangle's edges, so that none slips through between two that share one.
  template <class Visit>
  void crossed_by(const Triangle& triangle, Visit visit) const;
  // Calls visit(index, squared distance) for each point within `reach` of p.
  template <class Visit>
  void within(const Vec3& p, double reach, Visit visit) const;

 private:
  static double component(const Vec3& p, int axis) { return axis == 0 ? p.x : axis == 1 ? p.y : p.z; }
  std::array<double, 3> to_grid(const Vec3& p) const {
    return {(p.x - origin_.x) / spacing_, (p.y - origin_.y) / spacing_, (p.z - origin_.z) / spacing_};
  }
  // The whole numbers from `low` to `high` that lie on the axis, as first and end.
  std::array<std::int64_t, 2> range(double low, double high, int axis) const;

  Vec3 origin_;
  double spacing_;
  std::array<std::int64_t, 3> count_{};
  std::array<std::size_t, 3> step_{};
  std::size_t size_ = 0;
};

// Which ways between neighbouring points are blocked: bit a of a point for the one along axis a.
using Walls = std::vector<std::uint8_t>;

// Numbers the points from 0 by the parts that open ways connect, of those for which `wanted` holds; kNone elsewhere.
// Returns how many parts there are.
std::uint32_t flood(const SampleGrid& grid, const Walls& walls, const std::vector<std::uint8_t>& wanted,
                    std::vector<std::uint32_t>& parts);

template <class Visit>
void SampleGrid::in_tet(const Vec3 (&p)[4], Visit visit) const {
  // Four half-spaces normal . x <= offset, in grid coordinates.
  std::array<double, 3> g[4];
  double low[3], high[3];
  for (int i = 0; i < 4; ++i) g[i] = to_grid(p[i]);
  for (int a = 0; a < 3; ++a) {
    low[a] = std::min({g[0][a], g[1][a], g[2][a], g[3][a]});
    high[a] = std::max({g[0][a], g[1][a], g[2][a], g[3][a]});
  }
  double normal[4][3], offset[4];
  for (int f = 0; f < 4; ++f) {
    const auto &a = g[(f + 1) % 4], &b = g[(f + 2) % 4], &c = g[(f + 3) % 4], &opposite = g[f];
    for (int k = 0; k < 3; ++k) {
      const int u = (k + 1) % 3, v = (k + 2) % 3;
      normal[f][k] = (b[u] - a[u]) * (c[v] - a[v]) - (b[v] - a[v]) * (c[u] - a[u]);
    }
    const auto along = [&](const std::array<double, 3>& x) {
      return normal[f][0] * x[0] + normal[f][1] * x[1] + normal[f][2] * x[2];
    };
    offset[f] = along(a);
    if (along(opposite) > offset[f]) {
      for (double& n : normal[f]) n = -n;
      offset[f] = -offset[f];
    }
  }
  const auto js = range(low[1], high[1], 1), ks = range(low[2], high[2], 2);
  for (std::int64_t k = ks[0]; k < ks[1]; ++k) {
    for (std::int64_t j = js[0]; j < js[1]; ++j) {
      double from = low[0], to = high[0];
      bool empty = false;
      for (int f = 0; f < 4; ++f) {
        const double rest =
            offset[f] - normal[f][1] * static_cast<double>(j) - normal[f][2] * static_cast<double>(k);
        if (normal[f][0] > 0) {
          to = std::min(to, rest / normal[f][0]);
        } else if (normal[f][0] < 0) {
          from = std::max(from, rest / normal[f][0]);
        } else {
          empty = empty || rest < 0;
        }
      }
      if (empty || from > to) continue;
      const auto is = range(from, to, 0);
      for (std::int64_t i = is[0]; i < is[1]; ++i)
        visit(static_cast<std::size_t>(i) + static_cast<std::size_t>(j) * step_[1] +
              static_cast<std::size_t>(k) * step_[2]);
    }
  }
}

template <class Visit>
void SampleGrid::crossed_by(const Triangle& triangle, Visit visit) const {
  constexpr double kEdge = 1e-9;
  std::array<double, 3> g[3];
  for (int i = 0; i < 3; ++i) g[i] = to_grid(triangle.corners[i]);
  for (int axis = 0; axis < 3; ++axis) {
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    const double area = (g[1][u] - g[0][u]) * (g[2][v] - g[0][v]) - (g[1][v] - g[0][v]) * (g[2][u] - g[0][u]);
    if (area == 0) continue;
    const auto us = range(std::min({g[0][u], g[1][u], g[2][u]}) - kEdge,
                          std::max({g[0][u], g[1][u], g[2][u]}) + kEdge, u);
    const auto vs = range(std::min({g[0][v], g[1][v], g[2][v]}) - kEdge,
                          std::max({g[0][v], g[1][v], g[2][v]}) + kEdge, v);
    const double slack = -kEdge * std::max(1.0, 1 / std::abs(area));
    for (std::int64_t b = vs[0]; b < vs[1]; ++b) {
      for (std::int64_t a = us[0]; a < us[1]; ++a) {
        const double x = static_cast<double>(a), y = static_cast<double>(b);
        double weight[3];
        bool inside = true;
        for (int i = 0; i < 3 && inside; ++i) {
          const auto &p = g[(i + 1) % 3], &q = g[(i + 2) % 3];
          weight[i] = ((p[u] - x) * (q[v] - y) - (p[v] - y) * (q[u] - x)) / area;
          inside = weight[i] >= slack;
        }
        if (!inside) continue;
        const double at = weight[0] * g[0][axis] + weight[1] * g[1][axis] + weight[2] * g[2][axis];
        const auto n = static_cast<std::int64_t>(std::floor(at));
        if (n < 0 || n + 1 >= count_[axis]) continue;
        const std::size_t index = static_cast<std::size_t>(n) * step_[axis] +
                                  static_cast<std::size_t>(a) * step_[u] +
                                  static_cast<std::size_t>(b) * step_[v];
        double where[3];
        where[axis] = at;
        where[u] = x;
        where[v] = y;
        visit(index, axis, origin_ + spacing_ * Vec3{where[0], where[1], where[2]});
      }
    }
  }
}

template <class Visit>
void SampleGrid::within(const Vec3& p, double reach, Visit visit) const {
  const auto g = to_grid(p);
  const double r = reach / spacing_;
  const auto is = range(g[0] - r, g[0] + r, 0), js = range(g[1] - r, g[1] + r, 1),
             ks = range(g[2] - r, g[2] + r, 2);
  for (std::int64_t k = ks[0]; k < ks[1]; ++k) {
    for (std::int64_t j = js[0]; j < js[1]; ++j) {
      const double dj = static_cast<double>(j) - g[1], dk = static_cast<double>(k) - g[2];
      const double row = dj * dj + dk * dk;
      if (row > r * r) continue;
      for (std::int64_t i = is[0]; i < is[1]; ++i) {
        const double di = static_cast<double>(i) - g[0];
        const double d2 = row + di * di;
        if (d2 <= r * r)
          visit(static_cast<std::size_t>(i) + static_cast<std::size_t>(j) * step_[1] +
                    static_cast<std::size_t>(k) * step_[2],
                d2 * spacing_ * spacing_);
      }
    }
  }
}

}  // namespace incise::oracle
