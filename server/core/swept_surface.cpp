#include "server/core/swept_surface.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

namespace incise::core {
namespace {

double squared_distance_to_box(const Vec3& p, const Vec3& low, const Vec3& high) {
  const double x = std::max({low.x - p.x, p.x - high.x, 0.0});
  const double y = std::max({low.y - p.y, p.y - high.y, 0.0});
  const double z = std::max({low.z - p.z, p.z - high.z, 0.0});
  return x * x + y * y + z * z;
}

}  // namespace

void SweptSurface::add_quad(const BladeLine& from, const BladeLine& to, int rows, int columns,
                            std::uint32_t batch, bool first, const Vec3& low, const Vec3& high) {
  const auto corner = [&](int row, int column) {
    // A grid point must have the same bits whichever quad it is computed for: on the first and last line only that
    // line's ends count.
    const double s = static_cast<double>(row) / rows, c = static_cast<double>(column) / columns;
    const Vec3 heel = row == 0 ? from.heel : row == rows ? to.heel : lerp(from.heel, to.heel, s);
    const Vec3 tip = row == 0 ? from.tip : row == rows ? to.tip : lerp(from.tip, to.tip, s);
    return column == 0 ? heel : column == columns ? tip : lerp(heel, tip, c);
  };
  // Halves the block of cells across its longer side, over and over: the list's order then makes a good tree.
  const auto add = [&](const auto& self, int row, int row_end, int column, int column_end) -> void {
    if (row_end - row > 1 || column_end - column > 1) {
      if (row_end - row >= column_end - column) {
        const int middle = row + (row_end - row) / 2;
        self(self, row, middle, column, column_end);
        self(self, middle, row_end, column, column_end);
      } else {
        const int middle = column + (column_end - column) / 2;
        self(self, row, row_end, column, middle);
        self(self, row, row_end, middle, column_end);
      }
      return;
    }
    const Vec3 a = corner(row, column), b = corner(row, column + 1);
    const Vec3 c = corner(row + 1, column + 1), d = corner(row + 1, column);
    if (std::max({a.x, b.x, c.x, d.x}) < low.x || std::min({a.x, b.x, c.x, d.x}) > high.x ||
        std::max({a.y, b.y, c.y, d.y}) < low.y || std::min({a.y, b.y, c.y, d.y}) > high.y ||
        std::max({a.z, b.z, c.z, d.z}) < low.z || std::min({a.z, b.z, c.z, d.z}) > high.z) {
      return;
    }
    SweptTriangle triangle;
    triangle.batch = batch;
    if (make_swept_triangle(a, b, c, triangle)) {
      triangle.rim =
          static_cast<std::uint8_t>((first && row == 0 ? 1u : 0u) | (column + 1 == columns ? 2u : 0u));
      triangles_.push_back(triangle);
    }
    if (make_swept_triangle(a, c, d, triangle)) {
      triangle.rim = column == 0 ? 4 : 0;
      triangles_.push_back(triangle);
    }
  };
  add(add, 0, rows, 0, columns);
}

void SweptSurface::build() {
  leaves_ = std::bit_ceil(static_cast<std::uint32_t>(std::max<std::size_t>(triangles_.size(), 1)));
  const Box nothing{{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
  boxes_.assign(2 * static_cast<std::size_t>(leaves_), nothing);
  for (std::size_t i = 0; i < triangles_.size(); ++i)
    boxes_[leaves_ + i] = {triangles_[i].low, triangles_[i].high};
  for (std::size_t i = leaves_ - 1; i >= 1; --i) {
    const Box &a = boxes_[2 * i], &b = boxes_[2 * i + 1];
    boxes_[i] = {{std::min(a.low.x, b.low.x), std::min(a.low.y, b.low.y), std::min(a.low.z, b.low.z)},
                 {std::max(a.high.x, b.high.x), std::max(a.high.y, b.high.y), std::max(a.high.z, b.high.z)}};
  }
}

void SweptSurface::drop_before(std::uint32_t oldest) {
  std::erase_if(triangles_, [oldest](const SweptTriangle& t) { return t.batch < oldest; });
}

void SweptSurface::clear() {
  triangles_.clear();
  build();
}

bool SweptSurface::near(const Vec3& p, double reach, Vec3& point, std::uint32_t& triangle) const {
  if (triangle < triangles_.size()) {
    const SweptTriangle& s = triangles_[triangle];
    const double d = s.signed_distance(p);
    bool above = std::abs(d) < reach;
    for (int k = 0; k < 3; ++k) above = above && dot(s.inward[k], p) >= s.inward_offset[k];
    if (above) {
      point = p - d * s.normal;
      return true;
    }
  }
  return closest(p, reach, point, triangle);
}

bool SweptSurface::closest(const Vec3& p, double reach, Vec3& point, std::uint32_t& triangle) const {
  double best = reach * reach;
  bool found = false;
  if (triangles_.empty()) return false;
  std::uint32_t stack[64];
  int depth = 0;
  stack[depth++] = 1;
  while (depth > 0) {
    const std::uint32_t node = stack[--depth];
    if (squared_distance_to_box(p, boxes_[node].low, boxes_[node].high) >= best) continue;
    if (node < leaves_) {
      stack[depth++] = 2 * node + 1;
      stack[depth++] = 2 * node;
      continue;
    }
    const SweptTriangle& s = triangles_[node - leaves_];
    const double plane = s.signed_distance(p);
    if (plane * plane >= best) continue;
    const Vec3 x = closest_point(p, s);
    const double d2 = squared_length(x - p);
    if (d2 < best) {
      best = d2;
      point = x;
      triangle = node - leaves_;
      found = true;
    }
  }
  return found;
}

}  // namespace incise::core
