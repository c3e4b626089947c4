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
// What was swept one after the other is thin across the sweep and along the motion: boxes lie along the first triangle's, and in a large
// tree, which bends, each node's children lie between two pairs of planes of their own, too. Visits triangles in the order of the list.
class SweptTree {
 public:
  // Over triangles[from] and all after it. Those before triangles[same] are what they were when this was last called, with the same
  // `from`. Those before triangles[visited] are in the tree, but no query visits them. O(new triangles).
  void build(std::span<const SweptTriangle> triangles, std::size_t from, std::size_t same,
             std::size_t visited = 0);
  bool empty() const { return levels_.empty(); }

  // Calls visit(index) for each triangle whose box comes nearer than `slack_m` to that around some points, until it returns true; returns
  // whether one did. Leaves some of those out on one side of whose plane all the points lie, farther off than that.
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
  // A float is off by 2^-24 of itself at most: by this part of itself a slack is made larger, and by this part of the largest of three
  // coordinates a sum of their products is rounded outwards.
  static constexpr double kRounded = 0x1p-22, kRoundedSum = 0x1p-20;
  static constexpr std::size_t kMaxLevels = 14;
  static constexpr int kDepth = 4 * kMaxLevels;
  // What a stack holds: a node of a level.
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
    Lane along(const Lane (&p)[3]) const { return normal[0] * p[0] + normal[1] * p[1] + normal[2] * p[2]; }
  };
  struct Node {
    Lane low[3], high[3];
    Slab slabs[2];  // across the normal of what was swept there, and across its motion
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
  static float least(const Lane& v) {
    return std::min(std::min(v[0], v[1]), std::min(v[2], v[3]));
  }
  static float most(const Lane& v) {
    return std::max(std::max(v[0], v[1]), std::max(v[2], v[3]));
  }
  static double farthest(const Vec3& p) {
    return std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
  }
  Vec3 along_axes(const Vec3& p) const {
    return {dot(axes_[0], p), dot(axes_[1], p), dot(axes_[2], p)};
  }

  static Node empty_node();
  void set_child(Node& node, std::uint32_t k, std::size_t level, std::size_t child) const;
  void set_slabs(Node& node, std::uint32_t k, std::size_t begin, std::size_t end) const;

  // Visits the triangles that `meets` lets through: which of a node's children may hold one.
  template <class Meets, class Visit>
  bool walk(Meets meets, Visit visit) const {
    std::uint32_t stack[kDepth];
    int depth = 0;
    stack[depth++] = static_cast<std::uint32_t>(levels_.size() - 1) << kLevelShift;
    while (depth > 0) {
      const std::uint32_t at = stack[--depth], level = at >> kLevelShift, index = at & kIndexMask;
      std::uint32_t bits = meets(levels_[level][index], has_slabs_ && level > 0);
      if (level == 0) {
        const std::uint32_t first = from_ + kChildren * index;
        for (; bits != 0; bits &= bits - 1) {
          const std::uint32_t triangle = first + static_cast<std::uint32_t>(std::countr_zero(bits));
          if (triangle >= visited_ && visit(triangle)) return true;
        }
        continue;
      }
      // So that the first comes off the stack first.
      const std::uint32_t first = (level - 1) << kLevelShift | kChildren * index;
      while (bits != 0) {
        const auto k = static_cast<std::uint32_t>(std::bit_width(bits)) - 1;
        stack[depth++] = first + k;
        bits ^= 1u << k;
      }
    }
    return false;
  }

  std::span<const SweptTriangle> triangles_;  // while it is built
  std::uint32_t from_ = 0, visited_ = 0;
  std::vector<std::vector<Node>> levels_;  // the one above the triangles first, the root last
  bool has_slabs_ = false;
  // The first triangle's motion, its normal, and across both; and where all triangles lie along these.
  std::array<Vec3, 3> axes_{};
  std::array<double, 3> low_{}, high_{};
};

template <std::size_t N, class Visit>
bool SweptTree::any_between(const Points<N>& points, double slack_m, Visit visit) const {
  if (empty()) return false;
  double at[3][N], low[3], high[3];
  for (int axis = 0; axis < 3; ++axis) {
    points.along(axes_[axis], 0, at[axis]);
    low[axis] = Points<N>::least(at[axis]) - slack_m;
    high[axis] = Points<N>::most(at[axis]) + slack_m;
    // Most that is asked for lies beside all of it.
    if (low[axis] > high_[axis] || high[axis] < low_[axis]) return false;
  }
  Lane low_lanes[3], high_lanes[3], point_lanes[N][3]{}, slack{};
  for (int axis = 0; axis < 3; ++axis) {
    low_lanes[axis] = lane(low[axis]);
    high_lanes[axis] = lane(high[axis]);
  }
  if (has_slabs_) {
    double farthest_m = 0;
    for (int axis = 0; axis < 3; ++axis) {
      farthest_m = std::max({farthest_m, -low[axis], high[axis]});
      for (std::size_t i = 0; i < N; ++i) point_lanes[i][axis] = lane(at[axis][i]);
    }
    slack = lane((slack_m + kRoundedSum * farthest_m) * (1 + kRounded));
  }
  const auto meets = [&](const Node& node, bool slabs) {
    Lanes meet = (low_lanes[0] <= node.high[0]) & (high_lanes[0] >= node.low[0]);
    for (int axis = 1; axis < 3; ++axis)
      meet &= (low_lanes[axis] <= node.high[axis]) & (high_lanes[axis] >= node.low[axis]);
    const std::uint32_t hit = lanes_set(meet);
    if (hit == 0 || !slabs) return hit;
    for (const Slab& slab : node.slabs) {
      Lane least = slab.along(point_lanes[0]), most = least;
      for (std::size_t i = 1; i < N; ++i) {
        const Lane along = slab.along(point_lanes[i]);
        least = along < least ? along : least;
        most = along > most ? along : most;
      }
      meet &= (least - slack <= slab.above) & (most + slack >= slab.below);
    }
    return lanes_set(meet);
  };
  return walk(meets, visit);
}

template <class Visit>
void SweptTree::each_near(const Vec3& p, double& squared_reach, Visit visit) const {
  if (empty()) return;
  const Vec3 at = along_axes(p);
  const Lane point[3] = {lane(at.x), lane(at.y), lane(at.z)}, slack = lane(kRoundedSum * farthest(at));
  const auto beyond = [](const Lane& x, const Lane& low, const Lane& high) {
    const Lane none{}, under = low - x, over = x - high;
    const Lane gap = under > over ? under : over;
    return gap > none ? gap : none;
  };
  const auto meets = [&](const Node& node, bool slabs) {
    const Lane dx = beyond(point[0], node.low[0], node.high[0]),
               dy = beyond(point[1], node.low[1], node.high[1]),
               dz = beyond(point[2], node.low[2], node.high[2]);
    // The bounds are large enough for what was rounded in p; this is for the squares.
    constexpr double kSquares = 1 + 0x1p-20;
    const Lane limit = lane(kSquares * squared_reach);
    const Lanes boxes = dx * dx + dy * dy + dz * dz <= limit;
    const std::uint32_t hit = lanes_set(boxes);
    if (hit == 0 || !slabs) return hit;
    Lane off2{};
    for (const Slab& slab : node.slabs) {
      const Lane off = beyond(slab.along(point), slab.below - slack, slab.above + slack);
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
