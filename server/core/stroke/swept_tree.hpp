#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/geometry/four_points.hpp"
#include "server/core/stroke/swept_triangle.hpp"

namespace incise::core {

// A tree over the triangles of a swept surface, or over the last of them. They are in the order in which they were swept, so
// neighbours in the list are neighbours in space: the tree needs no sorting, and what is added to the list is added to the tree.
// What was swept one after the other is thin across the sweep and along the motion, but seldom along the axes: beside a box, each node's
// children lie between two pairs of planes. Visits triangles in the order of the list.
class SweptTree {
 public:
  // Over triangles[from] and all after it. Those before triangles[same] are what they were when this was last called, with the same
  // `from`. O(new triangles).
  void build(std::span<const SweptTriangle> triangles, std::size_t from, std::size_t same);
  bool empty() const { return levels_.empty(); }

  // Calls visit(index) for each triangle whose box overlaps the given one, until it returns true; returns whether one did.
  template <class Visit>
  bool any_overlapping(const Vec3& low, const Vec3& high, Visit visit) const {
    return overlapping(
        low, high, [](const Node&, const Lanes& boxes) { return boxes; }, visit);
  }
  // The same for the box around two or four points, larger by `slack_m` on all sides, but not for all triangles on one side of
  // whose plane all the points lie, farther off than that.
  template <std::size_t N, class Visit>
  bool any_between(const Points<N>& points, double slack_m, Visit visit) const;
  // Calls visit(index) for each triangle that may be nearer to p than sqrt(squared_reach), which visit() may lessen.
  template <class Visit>
  void each_near(const Vec3& p, double& squared_reach, Visit visit) const;

 private:
  // A node's children are looked at together, in lanes. Their bounds are rounded outwards by more than a query is rounded, so that none
  // that has to be visited is passed over.
  static constexpr std::uint32_t kChildren = 4;
  using Lane [[gnu::vector_size(16)]] = float;
  using Lanes = int __attribute__((vector_size(16)));  // what compares lanes gives: -1 where it holds, else 0
  // A float is off by 2^-24 of itself at most: by this part of itself a coordinate is rounded outwards, and a sum of products of
  // three by this part of the largest.
  static constexpr double kRounded = 0x1p-22, kRoundedSum = 0x1p-20;
  static constexpr std::size_t kMaxLevels = 14;
  static constexpr int kDepth = 4 * kMaxLevels;
  // What a stack holds: a node of a level, or a triangle: level 0.
  static constexpr int kLevelShift = 28;
  static constexpr std::uint32_t kIndexMask = (1u << kLevelShift) - 1;
  // The planes of so many levels are as near to each other as can be; those above have none, nor has the lowest, whose children are
  // single triangles: visit() looks at their own plane.
  static constexpr std::size_t kLevelsWithSlabs = 4;
  // In a tree of so few levels boxes are enough, and planes cost more than they save: it has none.
  static constexpr std::size_t kLevelsOfBoxes = 4;

  // What lies between two parallel planes.
  struct Slab {
    Lane normal[3], below, above;
    Lane along(const Lane& x, const Lane& y, const Lane& z) const {
      return normal[0] * x + normal[1] * y + normal[2] * z;
    }
  };
  struct Node {
    Lane low[3], high[3];
    Slab slabs[2];  // across the normal of what was swept, and across its motion
  };

  static Lane lane(double x) {
    const auto f = static_cast<float>(x);
    return Lane{f, f, f, f};
  }
  static std::uint32_t lanes_set(const Lanes& holds) {
#if defined(__SSE__)
    return static_cast<std::uint32_t>(__builtin_ia32_movmskps(reinterpret_cast<Lane>(holds)));
#else
    std::uint32_t bits = 0;
    for (std::uint32_t k = 0; k < kChildren; ++k) bits |= (holds[k] != 0 ? 1u : 0u) << k;
    return bits;
#endif
  }
  static double farthest(const Vec3& p) {
    return std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
  }

  bool has_slabs() const {
    return levels_.size() > kLevelsOfBoxes;
  }
  static Node empty_node();
  void set_child(Node& node, std::uint32_t k, std::size_t level, std::size_t child) const;
  void set_slabs(Node& node, std::uint32_t k, std::size_t begin, std::size_t end) const;

  // Visits the triangles that `meets` lets through: which of a node's children may hold one.
  template <class Meets, class Visit>
  bool walk(Meets meets, Visit visit) const {
    if (empty()) return false;
    std::uint32_t stack[kDepth];
    int depth = 0;
    stack[depth++] = static_cast<std::uint32_t>(levels_.size()) << kLevelShift;
    while (depth > 0) {
      const std::uint32_t at = stack[--depth], level = at >> kLevelShift, index = at & kIndexMask;
      if (level == 0) {
        if (visit(index)) return true;
        continue;
      }
      // So that the first comes off the stack first.
      const std::uint32_t first = (level - 1) << kLevelShift | ((level == 1 ? from_ : 0) + kChildren * index);
      for (std::uint32_t bits = meets(levels_[level - 1][index], has_slabs() && level > 1); bits != 0;) {
        const auto k = static_cast<std::uint32_t>(std::bit_width(bits)) - 1;
        stack[depth++] = first + k;
        bits ^= 1u << k;
      }
    }
    return false;
  }
  template <class Slabs, class Visit>
  bool overlapping(const Vec3& low, const Vec3& high, Slabs slabs, Visit visit) const {
    const Lane low_x = lane(low.x), low_y = lane(low.y), low_z = lane(low.z);
    const Lane high_x = lane(high.x), high_y = lane(high.y), high_z = lane(high.z);
    const auto meets = [&](const Node& node, bool has_slabs) {
      const Lanes boxes = (low_x <= node.high[0]) & (high_x >= node.low[0]) & (low_y <= node.high[1]) &
                          (high_y >= node.low[1]) & (low_z <= node.high[2]) & (high_z >= node.low[2]);
      const std::uint32_t hit = lanes_set(boxes);
      return hit == 0 || !has_slabs ? hit : lanes_set(slabs(node, boxes));
    };
    return walk(meets, visit);
  }

  std::span<const SweptTriangle> triangles_;  // while it is built
  std::uint32_t from_ = 0;
  std::vector<std::vector<Node>> levels_;  // the one above the triangles first, the root last
};

template <std::size_t N, class Visit>
bool SweptTree::any_between(const Points<N>& points, double slack_m, Visit visit) const {
  Vec3 low, high;
  points.bounds(low, high);
  const Vec3 by{slack_m, slack_m, slack_m};
  if (!has_slabs()) return any_overlapping(low - by, high + by, visit);
  Lane x[N], y[N], z[N];
  for (std::size_t i = 0; i < N; ++i) {
    x[i] = lane(points.x[i]);
    y[i] = lane(points.y[i]);
    z[i] = lane(points.z[i]);
  }
  const double rounded_m = kRoundedSum * std::max(farthest(low), farthest(high));
  const Lane slack = lane((slack_m + rounded_m) * (1 + kRounded));
  const auto slabs = [&](const Node& node, const Lanes& boxes) {
    Lanes meet = boxes;
    for (const Slab& slab : node.slabs) {
      Lane least = slab.along(x[0], y[0], z[0]), most = least;
      for (std::size_t i = 1; i < N; ++i) {
        const Lane at = slab.along(x[i], y[i], z[i]);
        least = at < least ? at : least;
        most = at > most ? at : most;
      }
      meet &= (least - slack <= slab.above) & (most + slack >= slab.below);
    }
    return meet;
  };
  return overlapping(low - by, high + by, slabs, visit);
}

template <class Visit>
void SweptTree::each_near(const Vec3& p, double& squared_reach, Visit visit) const {
  const Lane x = lane(p.x), y = lane(p.y), z = lane(p.z), slack = lane(kRoundedSum * farthest(p));
  const auto beyond = [](const Lane& at, const Lane& low, const Lane& high) {
    const Lane none{}, under = low - at, over = at - high;
    const Lane gap = under > over ? under : over;
    return gap > none ? gap : none;
  };
  const auto meets = [&](const Node& node, bool has_slabs) {
    const Lane dx = beyond(x, node.low[0], node.high[0]), dy = beyond(y, node.low[1], node.high[1]),
               dz = beyond(z, node.low[2], node.high[2]);
    // The bounds are large enough for what was rounded in p; this is for the squares.
    constexpr double kSquares = 1 + 0x1p-20;
    const Lane limit = lane(kSquares * squared_reach);
    const Lanes boxes = dx * dx + dy * dy + dz * dz <= limit;
    const std::uint32_t hit = lanes_set(boxes);
    if (hit == 0 || !has_slabs) return hit;
    Lane off2{};
    for (const Slab& slab : node.slabs) {
      const Lane off = beyond(slab.along(x, y, z), slab.below - slack, slab.above + slack);
      off2 += off * off;
    }
    return lanes_set(boxes & (off2 <= limit));
  };
  walk(meets, [&](std::uint32_t index) {
    visit(index);
    return false;
  });
}

}  // namespace incise::core
