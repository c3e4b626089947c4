#include "server/mesh_io/triangle_intersection.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "server/core/geometry/box.hpp"
#include "server/core/geometry/predicates.hpp"

namespace incise::mesh_io {
namespace {

using core::Box;
using core::coordinate;
using core::Vec3;
using core::VertexId;
using Triangle = std::array<VertexId, 3>;

// core::orient3d, with a shortcut for a case that is frequent with the plane faces of boxes and cylinders:
// the exact evaluation takes microseconds.
int side(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  if ((a.x == b.x && a.x == c.x && a.x == d.x) || (a.y == b.y && a.y == c.y && a.y == d.y) ||
      (a.z == b.z && a.z == c.z && a.z == d.z)) {
    return 0;
  }
  return core::orient3d(a, b, c, d);
}

int dominant_axis(const Vec3& normal) {
  const double x = std::abs(normal.x), y = std::abs(normal.y), z = std::abs(normal.z);
  return x >= y && x >= z ? 0 : y >= z ? 1 : 2;
}

// An axis along which a triangle that is not degenerate has an area.
int projection_axis(const Vec3& a, const Vec3& b, const Vec3& c) {
  const int axis = dominant_axis(core::cross(b - a, c - a));
  for (const int candidate : {axis, 0, 1, 2}) {
    if (orient2d(a, b, c, candidate) != 0) return candidate;
  }
  return axis;
}

// Whether segment pq meets segment ab, ends included; all four points lie in one plane, seen along `drop`.
bool segments_meet(const Vec3& p, const Vec3& q, const Vec3& a, const Vec3& b, int drop) {
  const int pa = orient2d(p, q, a, drop), pb = orient2d(p, q, b, drop);
  const int ap = orient2d(a, b, p, drop), aq = orient2d(a, b, q, drop);
  if (pa * pb > 0 || ap * aq > 0) return false;
  if (pa != 0 || pb != 0 || ap != 0 || aq != 0) return true;
  // On one line: do their boxes overlap?
  for (int axis = 0; axis < 3; ++axis) {
    if (axis == drop) continue;
    const auto [p0, p1] = std::minmax({coordinate(p, axis), coordinate(q, axis)});
    const auto [a0, a1] = std::minmax({coordinate(a, axis), coordinate(b, axis)});
    if (p1 < a0 || a1 < p0) return false;
  }
  return true;
}

bool contains(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& p, int drop) {
  const int s = orient2d(a, b, p, drop), t = orient2d(b, c, p, drop), u = orient2d(c, a, p, drop);
  return (s >= 0 && t >= 0 && u >= 0) || (s <= 0 && t <= 0 && u <= 0);
}

// Whether the closed segment pq meets the closed triangle abc.
bool segment_meets_triangle(const Vec3& p, const Vec3& q, const Vec3& a, const Vec3& b, const Vec3& c) {
  const int sp = side(a, b, c, p), sq = side(a, b, c, q);
  if (sp * sq > 0) return false;
  if (sp == 0 && sq == 0) {
    const int drop = projection_axis(a, b, c);
    return contains(a, b, c, p, drop) || contains(a, b, c, q, drop) || segments_meet(p, q, a, b, drop) ||
           segments_meet(p, q, b, c, drop) || segments_meet(p, q, c, a, drop);
  }
  const int s = side(p, q, a, b), t = side(p, q, b, c), u = side(p, q, c, a);
  return (s >= 0 && t >= 0 && u >= 0) || (s <= 0 && t <= 0 && u <= 0);
}

// Shewchuk's filter for the two-dimensional orientation (1997, section 4.2, bound A); 0 if it is not certain.
int filtered_orient2d(const Vec3& a, const Vec3& b, const Vec3& c, int drop) {
  const int x = drop == 0 ? 1 : 0, y = drop == 2 ? 1 : 2;
  const double left = (coordinate(a, x) - coordinate(c, x)) * (coordinate(b, y) - coordinate(c, y));
  const double right = (coordinate(a, y) - coordinate(c, y)) * (coordinate(b, x) - coordinate(c, x));
  const double determinant = left - right;
  const double bound = (3.0 + 16.0 * 0x1p-53) * 0x1p-53 * (std::abs(left) + std::abs(right));
  return determinant > bound ? 1 : -determinant > bound ? -1 : 0;
}

// Whether an edge of s certainly separates the two triangles except for their shared vertices: the edge
// contains all of these, and the rest of t lies strictly beyond it. Decides the neighbours in flat regions without
// exact arithmetic.
bool separated_by_edge(const std::vector<Vec3>& p, const Triangle& s, const Triangle& t, int drop) {
  for (std::size_t i = 0; i < 3; ++i) {
    const VertexId u = s[i], v = s[(i + 1) % 3], w = s[(i + 2) % 3];
    const int inside = filtered_orient2d(p[u], p[v], p[w], drop);
    if (inside == 0) continue;
    bool separates = true;
    for (const VertexId x : t) {
      if (x == u || x == v) continue;
      if (x == w || filtered_orient2d(p[u], p[v], p[x], drop) != -inside) {
        separates = false;
        break;
      }
    }
    if (separates) return true;
  }
  return false;
}

// A tree of boxes over the triangles of a surface, split at the median along the longest side.
class BoxTree {
 public:
  explicit BoxTree(const Surface& surface) {
    boxes_.reserve(surface.triangles.size());
    for (const Triangle& t : surface.triangles) {
      Box box{surface.positions[t[0]], surface.positions[t[0]]};
      for (const VertexId v : t) box.add({surface.positions[v], surface.positions[v]});
      boxes_.push_back(box);
    }
    order_.resize(boxes_.size());
    for (std::uint32_t i = 0; i < order_.size(); ++i) order_[i] = i;
    if (!order_.empty()) build(0, static_cast<std::uint32_t>(order_.size()));
  }

  // Calls visit(i, j) for each pair i < j of triangles whose boxes meet, until it returns false.
  template <class Visit>
  void pairs(Visit visit) const {
    std::vector<std::uint32_t> stack;
    for (std::uint32_t i = 0; i < boxes_.size(); ++i) {
      stack.assign(1, 0);
      while (!stack.empty()) {
        const Node& node = nodes_[stack.back()];
        stack.pop_back();
        if (node.highest <= i || !node.box.meets(boxes_[i])) continue;
        if (node.right != 0) {
          stack.push_back(node.right);
          stack.push_back(node.left);
          continue;
        }
        for (std::uint32_t k = node.first; k < node.last; ++k) {
          const std::uint32_t j = order_[k];
          if (j > i && boxes_[i].meets(boxes_[j]) && !visit(i, j)) return;
        }
      }
    }
  }

 private:
  struct Node {
    Box box;
    std::uint32_t first, last;  // range of order_
    std::uint32_t highest;      // index of a triangle in it
    std::uint32_t left = 0, right = 0;
  };
  static constexpr std::uint32_t kLeafSize = 4;

  std::uint32_t build(std::uint32_t first, std::uint32_t last) {
    const auto index = static_cast<std::uint32_t>(nodes_.size());
    Node node{boxes_[order_[first]], first, last, 0};
    for (std::uint32_t k = first; k < last; ++k) {
      node.box.add(boxes_[order_[k]]);
      node.highest = std::max(node.highest, order_[k]);
    }
    nodes_.push_back(node);
    if (last - first <= kLeafSize) return index;
    const int axis = dominant_axis(node.box.high - node.box.low);
    const std::uint32_t middle = first + (last - first) / 2;
    std::nth_element(order_.begin() + first, order_.begin() + middle, order_.begin() + last,
                     [&](std::uint32_t a, std::uint32_t b) {
                       const double ca = coordinate(boxes_[a].low + boxes_[a].high, axis);
                       const double cb = coordinate(boxes_[b].low + boxes_[b].high, axis);
                       return ca != cb ? ca < cb : a < b;
                     });
    const std::uint32_t left = build(first, middle), right = build(middle, last);
    nodes_[index].left = left;
    nodes_[index].right = right;
    return index;
  }

  std::vector<Box> boxes_;
  std::vector<std::uint32_t> order_;
  std::vector<Node> nodes_;
};

}  // namespace

int orient2d(const Vec3& a, const Vec3& b, const Vec3& c, int drop) {
  if (const int sign = filtered_orient2d(a, b, c, drop); sign != 0) return sign;
  const int x = drop == 0 ? 1 : 0, y = drop == 2 ? 1 : 2;
  const auto flat = [x, y](const Vec3& p) { return Vec3{coordinate(p, x), coordinate(p, y), 0}; };
  // The volume over the flat triangle and a point above its first corner has the sign of its area.
  return core::orient3d(flat(a), flat(b), flat(c), {coordinate(a, x), coordinate(a, y), 1});
}

bool is_collinear(const Vec3& a, const Vec3& b, const Vec3& c) {
  return orient2d(a, b, c, 0) == 0 && orient2d(a, b, c, 1) == 0 && orient2d(a, b, c, 2) == 0;
}

bool triangles_meet(const std::vector<Vec3>& p, const Triangle& s, const Triangle& t) {
  // Shared vertices first, in the same order in both.
  Triangle a = s, b = t;
  std::size_t shared = 0;
  for (std::size_t i = shared; i < 3; ++i) {
    const auto match = std::find(b.begin() + shared, b.end(), a[i]);
    if (match == b.end()) continue;
    std::swap(*match, b[shared]);
    std::swap(a[i], a[shared]);
    ++shared;
  }
  if (shared == 3) return true;
  const int drop = dominant_axis(core::cross(p[a[1]] - p[a[0]], p[a[2]] - p[a[0]]));
  if (separated_by_edge(p, a, b, drop) || separated_by_edge(p, b, a, drop)) return false;
  if (shared == 2) {
    // Around a shared edge two triangles overlap only if one is folded onto the other.
    if (side(p[a[0]], p[a[1]], p[a[2]], p[b[2]]) != 0) return false;
    const int axis = projection_axis(p[a[0]], p[a[1]], p[a[2]]);
    return orient2d(p[a[0]], p[a[1]], p[a[2]], axis) == orient2d(p[a[0]], p[a[1]], p[b[2]], axis);
  }
  if (shared == 1) {
    // Their intersection is convex and starts at the shared vertex, so it ends on an edge opposite to it.
    return segment_meets_triangle(p[a[1]], p[a[2]], p[b[0]], p[b[1]], p[b[2]]) ||
           segment_meets_triangle(p[b[1]], p[b[2]], p[a[0]], p[a[1]], p[a[2]]);
  }
  const auto all_on_one_side = [&p](const Triangle& plane, const Triangle& other) {
    const int first = side(p[plane[0]], p[plane[1]], p[plane[2]], p[other[0]]);
    return first != 0 && first == side(p[plane[0]], p[plane[1]], p[plane[2]], p[other[1]]) &&
           first == side(p[plane[0]], p[plane[1]], p[plane[2]], p[other[2]]);
  };
  if (all_on_one_side(a, b) || all_on_one_side(b, a)) return false;
  for (std::size_t i = 0; i < 3; ++i) {
    if (segment_meets_triangle(p[a[i]], p[a[(i + 1) % 3]], p[b[0]], p[b[1]], p[b[2]])) return true;
    if (segment_meets_triangle(p[b[i]], p[b[(i + 1) % 3]], p[a[0]], p[a[1]], p[a[2]])) return true;
  }
  return false;
}

std::vector<std::pair<std::size_t, std::size_t>> self_intersections(const Surface& surface,
                                                                    std::size_t limit) {
  std::vector<std::pair<std::size_t, std::size_t>> found;
  BoxTree(surface).pairs([&](std::uint32_t i, std::uint32_t j) {
    if (triangles_meet(surface.positions, surface.triangles[i], surface.triangles[j]))
      found.emplace_back(i, j);
    return found.size() < limit;
  });
  std::sort(found.begin(), found.end());
  return found;
}

}  // namespace incise::mesh_io
