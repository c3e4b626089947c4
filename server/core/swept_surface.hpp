#pragma once

#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/swept_triangle.hpp"

namespace incise::core {

// The surface that a blade has swept, as triangles, with a tree of bounding boxes over them. The triangles come in
// the order in which they were swept, so that neighbours in the list are neighbours in space: the tree needs no
// sorting, and is made anew in O(triangles) when some are added.
class SweptSurface {
 public:
  // Adds the ruled quad between two blade lines, cut into `rows` strips along the motion and `columns` along the
  // blade, each cell as two triangles. Call build() before the next query.
  // Cells beyond the box from `low` to `high`, that of the tissue, are left out.
  // The heel's and the tip's path are rims of the sweep, and so is the line `from` where `first` says so.
  void add_quad(const BladeLine& from, const BladeLine& to, int rows, int columns, std::uint32_t batch,
                bool first, const Vec3& low = {-INFINITY, -INFINITY, -INFINITY},
                const Vec3& high = {INFINITY, INFINITY, INFINITY});
  // `latest`: the first triangle of the last batch.
  void build(std::size_t latest = SIZE_MAX);
  // Forgets all triangles of batches before `oldest`.
  void drop_before(std::uint32_t oldest);
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
  // The same for the triangles of the last batch alone.
  template <class Visit>
  bool any_latest_overlapping(const Vec3& low, const Vec3& high, Visit visit) const {
    return overlapping(latest_, low, high, visit);
  }

  // The closest point of the surface within `reach` of p and its triangle; false where there is none.
  bool closest(const Vec3& p, double reach, Vec3& point, std::uint32_t& triangle) const;
  // A point of the surface straight above or below p, within `reach`: on the triangle that is passed in where p is
  // over that, else the closest point of all.
  bool near(const Vec3& p, double reach, Vec3& point, std::uint32_t& triangle) const;

 private:
  friend struct SessionFields;  // session_state.cpp

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

  struct Tree {
    std::vector<Node> nodes;  // the lowest level first
    std::uint32_t root = 0;   // kLeaf and the triangle where there is but one
    bool empty = true;
  };
  void build(Tree& tree, std::size_t from);
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
      for (std::uint32_t k = kChildren; k-- > 0;) {
        if (hit[k]) stack[depth++] = node.first + k;
      }
    }
    return false;
  }

  std::vector<SweptTriangle> triangles_;
  Tree all_, latest_;
};

}  // namespace incise::core
