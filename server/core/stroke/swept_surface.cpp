#include "server/core/stroke/swept_surface.hpp"

#include <algorithm>
#include <cmath>

namespace incise::core {
namespace {

// By this part of itself a coordinate is rounded outwards: a float is off by 2^-24 of itself at most.
constexpr double kRounded = 0x1p-22;

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

void SweptSurface::add_strip(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d,
                             std::uint32_t batch) {
  SweptTriangle triangle;
  triangle.batch = batch;
  if (make_swept_triangle(a, b, c, triangle)) triangles_.push_back(triangle);
  if (make_swept_triangle(a, c, d, triangle)) triangles_.push_back(triangle);
}

void SweptSurface::build(std::size_t latest) {
  build(all_, 0, [](const SweptTriangle& triangle, Vec3& low, Vec3& high) {
    low = triangle.low;
    high = triangle.high;
  });
  const std::size_t from = std::min(latest, triangles_.size());
  latest_axes_ = axes_of(from);
  latest_low_ = {INFINITY, INFINITY, INFINITY};
  latest_high_ = {-INFINITY, -INFINITY, -INFINITY};
  build(latest_, from, [this](const SweptTriangle& triangle, Vec3& low, Vec3& high) {
    low = {INFINITY, INFINITY, INFINITY};
    high = {-INFINITY, -INFINITY, -INFINITY};
    double farthest = 0;
    for (const Vec3& corner : triangle.corners) {
      const Vec3 p{dot(latest_axes_.blade, corner), dot(latest_axes_.motion, corner),
                   dot(latest_axes_.normal, corner)};
      extend(p, low, high);
      farthest = std::max({farthest, std::abs(corner.x), std::abs(corner.y), std::abs(corner.z)});
    }
    // What turning the coordinates may round.
    const double off = kRounded * farthest;
    low = low - Vec3{off, off, off};
    high += {off, off, off};
    extend(low, latest_low_, latest_high_);
    extend(high, latest_low_, latest_high_);
  });
}

// Those of the triangles from `from` on.
SweptSurface::Axes SweptSurface::axes_of(std::size_t from) const {
  if (from == triangles_.size()) return {};
  // A blade that goes back and forth turns the normals over.
  Vec3 sum{};
  for (std::size_t i = from; i < triangles_.size(); ++i) {
    const Vec3& n = triangles_[i].normal;
    sum += dot(n, triangles_[from].normal) < 0 ? -n : n;
  }
  const Vec3 normal = normalized(sum);
  const auto& corners = triangles_[from].corners;
  const Vec3 motion = normalized(cross(normal, corners[1] - corners[0]));
  if (squared_length(motion) == 0) return {};
  return {cross(motion, normal), motion, normal};
}

// Builds the tree over triangles_[from] and all after it.
template <class BoxOf>
void SweptSurface::build(Tree& tree, std::size_t from, BoxOf box_of) {
  const auto first = static_cast<std::uint32_t>(from);
  auto& nodes = tree.nodes;
  nodes.clear();
  const auto count = static_cast<std::uint32_t>(triangles_.size());
  tree.empty = first == count;
  if (tree.empty) return;
  const auto box = [](Node& node, std::uint32_t k, const Vec3& low, const Vec3& high) {
    const auto below = [](double x) { return static_cast<float>(x - kRounded * std::abs(x)); };
    const auto above = [](double x) { return static_cast<float>(x + kRounded * std::abs(x)); };
    node.low[0][k] = below(low.x);
    node.low[1][k] = below(low.y);
    node.low[2][k] = below(low.z);
    node.high[0][k] = above(high.x);
    node.high[1][k] = above(high.y);
    node.high[2][k] = above(high.z);
  };
  const auto empty = [](std::uint32_t child) {
    Node node;
    for (auto& lanes : node.low) lanes = lane(INFINITY);
    for (auto& lanes : node.high) lanes = lane(-INFINITY);
    node.first = child;
    return node;
  };
  for (std::uint32_t i = first; i < count; i += kChildren) {
    Node node = empty(i | kLeaf);
    for (std::uint32_t k = 0; k < kChildren && i + k < count; ++k) {
      Vec3 low, high;
      box_of(triangles_[i + k], low, high);
      box(node, k, low, high);
    }
    nodes.push_back(node);
  }
  std::uint32_t begin = 0;
  while (nodes.size() - begin > 1) {
    const auto end = static_cast<std::uint32_t>(nodes.size());
    for (std::uint32_t i = begin; i < end; i += kChildren) {
      Node node = empty(i);
      for (std::uint32_t k = 0; k < kChildren && i + k < end; ++k) {
        const Node& child = nodes[i + k];
        for (int axis = 0; axis < 3; ++axis) {
          const auto least = [](const Lane& l) {
            return std::min(std::min(l[0], l[1]), std::min(l[2], l[3]));
          };
          const auto most = [](const Lane& l) {
            return std::max(std::max(l[0], l[1]), std::max(l[2], l[3]));
          };
          node.low[axis][k] = least(child.low[axis]);
          node.high[axis][k] = most(child.high[axis]);
        }
      }
      nodes.push_back(node);
    }
    begin = end;
  }
  tree.root = static_cast<std::uint32_t>(nodes.size() - 1);
}

std::size_t SweptSurface::drop_before(std::uint32_t oldest) {
  return std::erase_if(triangles_, [oldest](const SweptTriangle& t) { return t.batch < oldest; });
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
  if (all_.empty) return false;
  const Lane x = lane(p.x), y = lane(p.y), z = lane(p.z), none{};
  const auto beyond = [none](const Lane& at, const Lane& low, const Lane& high) {
    const Lane under = low - at, over = at - high;
    const Lane gap = under > over ? under : over;
    return gap > none ? gap : none;
  };
  std::uint32_t stack[kDepth];
  int depth = 0;
  stack[depth++] = all_.root;
  while (depth > 0) {
    const std::uint32_t at = stack[--depth];
    if (!(at & kLeaf)) {
      const Node& node = all_.nodes[at];
      const Lane dx = beyond(x, node.low[0], node.high[0]), dy = beyond(y, node.low[1], node.high[1]),
                 dz = beyond(z, node.low[2], node.high[2]);
      // The boxes are large enough for what was rounded in p; this is for the squares.
      constexpr double kSquares = 1 + 0x1p-20;
      push_children(node, dx * dx + dy * dy + dz * dz <= lane(kSquares * best), stack, depth);
      continue;
    }
    const SweptTriangle& s = triangles_[at & ~kLeaf];
    const double plane = s.signed_distance(p);
    if (plane * plane >= best) continue;
    const Vec3 q = closest_point(p, s);
    const double d2 = squared_length(q - p);
    if (d2 < best) {
      best = d2;
      point = q;
      triangle = at & ~kLeaf;
      found = true;
    }
  }
  return found;
}

void SweptSurface::archive(Archive& io) {
  io.list(triangles_, 253, [&](SweptTriangle& t) {
    for (Vec3& corner : t.corners) io(corner);
    io(t.normal);
    io(t.offset);
    io(t.low);
    io(t.high);
    for (Vec3& inward : t.inward) io(inward);
    for (double& offset : t.inward_offset) io(offset);
    io(t.batch);
    io(t.rim);
  });
}

}  // namespace incise::core
