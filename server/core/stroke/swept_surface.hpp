#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/geometry/four_points.hpp"
#include "server/core/stroke/swept_triangle.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// The surface that a blade has swept, as triangles, with a tree of bounding boxes over them. Triangles are in
// the order in which they were swept, so neighbours in the list are neighbours in space: the tree needs no sorting and is
// rebuilt in O(triangles) when some are added.
class SweptSurface {
 public:
  // Adds the ruled quad between two blade lines, cut into `rows` strips along the motion and `columns` along the
  // blade, each cell as two triangles. Call build() before the next query.
  // Cells beyond the box from `low` to `high`, that of the tissue, are left out.
  // The heel's and the tip's path are rims of the sweep, and so is the line `from` where `first` says so.
  void add_quad(const BladeLine& from, const BladeLine& to, int rows, int columns, std::uint32_t batch,
                bool first, const Vec3& low = {-INFINITY, -INFINITY, -INFINITY},
                const Vec3& high = {INFINITY, INFINITY, INFINITY});
  // Adds the quad with these corners in turn, none of whose sides is a rim.
  void add_strip(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d, std::uint32_t batch);
  // `latest`: the first triangle of the last batch.
  void build(std::size_t latest = SIZE_MAX);
  // Forgets all triangles of batches before `oldest`; returns how many. Call build() before the next query.
  std::size_t drop_before(std::uint32_t oldest);
  void clear();

  std::size_t size() const { return triangles_.size(); }
  const SweptTriangle& operator[](std::size_t i) const { return triangles_[i]; }
  std::span<const SweptTriangle> triangles() const { return triangles_; }

  // Calls visit(index) for each triangle whose bounding box overlaps the given one, in order, until it returns true;
  // returns whether one did.
  template <class Visit>
  bool any_overlapping(const Vec3& low, const Vec3& high, Visit visit) const {
    return overlapping(all_, low, high, visit);
  }
  // The same for the triangles of the last batch alone and the box around four points, larger by `slack` on all sides. These
  // boxes lie along that batch's sweep, which is thin in at least one direction, so that few overlap without touching.
  template <class Visit>
  bool any_latest_overlapping(const FourPoints& points, double slack, Visit visit) const {
    const auto range = [&points, slack](const Vec3& axis, double& low, double& high) {
      double at[4];
      points.along(axis, 0, at);
      low = FourPoints::least(at) - slack;
      high = FourPoints::most(at) + slack;
    };
    // The thin directions first: most that is asked for misses all of the sweep.
    Vec3 low, high;
    range(latest_axes_.motion, low.y, high.y);
    if (low.y > latest_high_.y || high.y < latest_low_.y) return false;
    range(latest_axes_.normal, low.z, high.z);
    if (low.z > latest_high_.z || high.z < latest_low_.z) return false;
    range(latest_axes_.blade, low.x, high.x);
    return overlapping(latest_, low, high, visit);
  }

  // build() follows what is read.
  void archive(Archive& io);

  // The closest point of the surface, as it was when it was built, within `reach` of p and its triangle; false if
  // nothing is within reach.
  bool closest(const Vec3& p, double reach, Vec3& point, std::uint32_t& triangle) const;
  // Whether there is one.
  bool is_within(const Vec3& p, double reach) const {
    Vec3 point;
    std::uint32_t triangle;
    return closest(p, reach, point, triangle);
  }
  // A point of the surface straight above or below p, within `reach`: on the triangle that is passed in where p is
  // over that, else the closest point of all.
  bool near(const Vec3& p, double reach, Vec3& point, std::uint32_t& triangle) const;

 private:
  // A node's children are looked at together, in lanes. Their boxes are rounded outwards by more than a query is rounded, so
  // that none that overlaps is passed over.
  static constexpr std::uint32_t kChildren = 4;
  static constexpr std::uint32_t kLeaf = 1u << 31;  // marks a triangle among nodes
  static constexpr int kDepth = 64;  // three of each level wait, and four of the last: 16 levels, at most
  using Lane [[gnu::vector_size(16)]] = float;
  struct Node {
    Lane low[3], high[3];
    std::uint32_t first;  // of its children, which are neighbours; with kLeaf where they are triangles
  };
  static Lane lane(double x) {
    const auto f = static_cast<float>(x);
    return Lane{f, f, f, f};
  }

  using Lanes = int __attribute__((vector_size(16)));
  // What compares lanes gives: -1 where it holds, else 0.
  static std::uint32_t lanes_set(const Lanes& holds) {
#if defined(__SSE__)
    return static_cast<std::uint32_t>(__builtin_ia32_movmskps(reinterpret_cast<Lane>(holds)));
#else
    std::uint32_t bits = 0;
    for (std::uint32_t k = 0; k < kChildren; ++k) bits |= (holds[k] != 0 ? 1u : 0u) << k;
    return bits;
#endif
  }
  // The children whose lanes hold, so that the first comes off the stack first.
  static void push_children(const Node& node, const Lanes& holds, std::uint32_t* stack, int& depth) {
    for (std::uint32_t bits = lanes_set(holds); bits != 0;) {
      const auto k = static_cast<std::uint32_t>(std::bit_width(bits)) - 1;
      stack[depth++] = node.first + k;
      bits ^= 1u << k;
    }
  }

  struct Tree {
    std::vector<Node> nodes;  // the lowest level first
    std::uint32_t root = 0;
    bool empty = true;
  };
  // Along the blade, along its motion and along the normal of what a batch has swept; orthonormal.
  struct Axes {
    Vec3 blade{1, 0, 0}, motion{0, 1, 0}, normal{0, 0, 1};
  };
  Axes axes_of(std::size_t from) const;
  template <class BoxOf>
  void build(Tree& tree, std::size_t from, BoxOf box_of);
  template <class Visit>
  static bool overlapping(const Tree& tree, const Vec3& low, const Vec3& high, Visit visit) {
    if (tree.empty) return false;
    const Lane low_x = lane(low.x), low_y = lane(low.y), low_z = lane(low.z);
    const Lane high_x = lane(high.x), high_y = lane(high.y), high_z = lane(high.z);
    std::uint32_t stack[kDepth];
    int depth = 0;
    stack[depth++] = tree.root;
    while (depth > 0) {
      const std::uint32_t at = stack[--depth];
      if (at & kLeaf) {
        if (visit(at & ~kLeaf)) return true;
        continue;
      }
      const Node& node = tree.nodes[at];
      const auto hit = (low_x <= node.high[0]) & (high_x >= node.low[0]) & (low_y <= node.high[1]) &
                       (high_y >= node.low[1]) & (low_z <= node.high[2]) & (high_z >= node.low[2]);
      push_children(node, hit, stack, depth);
    }
    return false;
  }

  std::vector<SweptTriangle> triangles_;
  Tree all_, latest_;
  Axes latest_axes_;
  Vec3 latest_low_, latest_high_;  // of all of the last batch, along its axes
};

}  // namespace incise::core
