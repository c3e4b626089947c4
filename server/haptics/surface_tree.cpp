#include "server/haptics/surface_tree.hpp"

#include <algorithm>
#include <cmath>

#include "server/core/stroke/swept_triangle.hpp"

namespace incise::haptics {
namespace {

using core::BladeLine;
using core::Vec3;

constexpr std::uint32_t kLeaf = 4;
// Halving 2^32 triangles; each level leaves one node on the stack.
constexpr int kDeepest = 40;

double along_axis(const Vec3& p, int axis) noexcept {
  return axis == 0 ? p.x : axis == 1 ? p.y : p.z;
}

// Whether p + t d is in the box for some t in [0, to].
bool meets(const Vec3& p, const Vec3& d, double to, const Vec3& low, const Vec3& high) noexcept {
  double from = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const double at = along_axis(p, axis), step = along_axis(d, axis);
    const double l = along_axis(low, axis), h = along_axis(high, axis);
    if (step == 0) {
      if (at < l || at > h) return false;
      continue;
    }
    const double a = (l - at) / step, b = (h - at) / step;
    from = std::max(from, std::min(a, b));
    to = std::min(to, std::max(a, b));
  }
  return from <= to;
}

double squared_distance(const Vec3& p, const Vec3& low, const Vec3& high) noexcept {
  const Vec3 nearest{std::clamp(p.x, low.x, high.x), std::clamp(p.y, low.y, high.y),
                     std::clamp(p.z, low.z, high.z)};
  return squared_length(p - nearest);
}

}  // namespace

SurfaceTree::SurfaceTree(const core::TetMesh& mesh) {
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    for (int f = 0; f < 4; ++f) {
      if (mesh.neighbor(t, f) != core::kNone) continue;
      const core::HalfFace face = core::half_face(t, f);
      const auto v = mesh.face_vertices(face);
      triangles_.push_back({mesh.position(v[0]), mesh.position(v[1]), mesh.position(v[2]), face});
    }
  }
  if (triangles_.empty()) return;
  nodes_.reserve(2 * triangles_.size() / (kLeaf / 2));
  build(0, static_cast<std::uint32_t>(triangles_.size()));
}

void SurfaceTree::build(std::uint32_t begin, std::uint32_t end) {
  const std::size_t self = nodes_.size();
  nodes_.emplace_back();
  Vec3 low = triangles_[begin].a, high = low, inner_low{INFINITY, INFINITY, INFINITY},
       inner_high{-INFINITY, -INFINITY, -INFINITY};
  const auto middle = [](const Triangle& t) { return t.a + t.b + t.c; };
  for (std::uint32_t i = begin; i < end; ++i) {
    const Triangle& t = triangles_[i];
    for (const Vec3* p : {&t.a, &t.b, &t.c}) extend(*p, low, high);
    extend(middle(t), inner_low, inner_high);
  }
  // A flat box must not be missed by rounding.
  const double pad = 1e-12 * (length(low) + length(high));
  low = low - Vec3{pad, pad, pad};
  high = high + Vec3{pad, pad, pad};
  const Vec3 size = inner_high - inner_low;
  const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
  nodes_[self] = {low, high, begin, end - begin, 0, axis};
  if (end - begin <= kLeaf) return;
  const std::uint32_t half = begin + (end - begin) / 2;
  std::nth_element(triangles_.begin() + begin, triangles_.begin() + half, triangles_.begin() + end,
                   [&](const Triangle& a, const Triangle& b) {
                     return along_axis(middle(a), axis) < along_axis(middle(b), axis);
                   });
  nodes_[self].count = 0;
  build(begin, half);
  nodes_[self].right = static_cast<std::uint32_t>(nodes_.size());
  build(half, end);
}

template <class Visit>
void SurfaceTree::along(const BladeLine& line, double& to, ProbeWork& work, Visit visit) const noexcept {
  if (nodes_.empty()) return;
  const Vec3 d = line.tip - line.heel;
  std::uint32_t stack[kDeepest];
  int waiting = 0;
  stack[waiting++] = 0;
  while (waiting > 0) {
    const std::uint32_t at = stack[--waiting];
    if (!work.box()) return;
    const Node& node = nodes_[at];
    if (!meets(line.heel, d, to, node.low, node.high)) continue;
    if (node.count == 0) {
      const bool forward = along_axis(d, node.axis) >= 0;
      stack[waiting++] = forward ? node.right : at + 1;
      stack[waiting++] = forward ? at + 1 : node.right;
      continue;
    }
    for (std::uint32_t i = node.first; i < node.first + node.count; ++i) {
      if (!work.triangle()) return;
      const Vec3 a = triangles_[i].a - line.heel, b = triangles_[i].b - line.heel,
                 c = triangles_[i].c - line.heel;
      const double ab = dot(cross(a, b), d), bc = dot(cross(b, c), d), ca = dot(cross(c, a), d);
      if (!((ab >= 0 && bc >= 0 && ca >= 0) || (ab <= 0 && bc <= 0 && ca <= 0))) continue;
      const double sum = ab + bc + ca;
      if (sum == 0) continue;
      const double where = (ab * dot(c, d) + bc * dot(a, d) + ca * dot(b, d)) / (sum * squared_length(d));
      if (!(where >= 0 && where <= to)) continue;
      visit(Crossing{where, triangles_[i].face, dot(cross(b - a, c - a), d) < 0});
    }
  }
}

std::size_t SurfaceTree::crossings(const BladeLine& line, std::span<Crossing> found,
                                   ProbeWork& work) const noexcept {
  std::size_t count = 0;
  double to = 1;
  along(line, to, work, [&](const Crossing& crossing) {
    if (count == found.size()) {
      work.cut_short = true;
      return;
    }
    found[count++] = crossing;
  });
  std::sort(found.begin(), found.begin() + static_cast<std::ptrdiff_t>(count),
            [](const Crossing& a, const Crossing& b) { return a.at < b.at; });
  return count;
}

std::optional<Crossing> SurfaceTree::first_crossing(const BladeLine& line, ProbeWork& work) const noexcept {
  std::optional<Crossing> first;
  double to = 1;
  along(line, to, work, [&](const Crossing& crossing) {
    first = crossing;
    to = crossing.at;
  });
  return first;
}

std::optional<SurfacePoint> SurfaceTree::nearest(const Vec3& p, double radius,
                                                 ProbeWork& work) const noexcept {
  std::optional<SurfacePoint> found;
  if (nodes_.empty()) return found;
  double nearest2 = radius * radius;
  std::uint32_t stack[kDeepest];
  int waiting = 0;
  stack[waiting++] = 0;
  while (waiting > 0) {
    const std::uint32_t at = stack[--waiting];
    if (!work.box()) break;
    const Node& node = nodes_[at];
    if (squared_distance(p, node.low, node.high) >= nearest2) continue;
    if (node.count == 0) {
      const Node &left = nodes_[at + 1], &right = nodes_[node.right];
      const bool left_first =
          squared_distance(p, left.low, left.high) <= squared_distance(p, right.low, right.high);
      stack[waiting++] = left_first ? node.right : at + 1;
      stack[waiting++] = left_first ? at + 1 : node.right;
      continue;
    }
    for (std::uint32_t i = node.first; i < node.first + node.count; ++i) {
      if (!work.triangle()) break;
      const Triangle& t = triangles_[i];
      const Vec3 point = core::closest_point(p, t.a, t.b, t.c);
      const double distance2 = squared_length(p - point);
      if (distance2 >= nearest2) continue;
      nearest2 = distance2;
      found = SurfacePoint{point, cross(t.b - t.a, t.c - t.a), 0, t.face};
    }
  }
  if (!found) return found;
  found->distance_m = std::sqrt(nearest2);
  found->normal = normalized(found->normal);
  return found;
}

}  // namespace incise::haptics
