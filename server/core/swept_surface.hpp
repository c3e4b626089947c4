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
  void build();
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
    if (triangles_.empty()) return false;
    std::uint32_t stack[64];
    int depth = 0;
    stack[depth++] = 1;
    while (depth > 0) {
      const std::uint32_t node = stack[--depth];
      const Box& box = boxes_[node];
      if (low.x > box.high.x || high.x < box.low.x || low.y > box.high.y || high.y < box.low.y ||
          low.z > box.high.z || high.z < box.low.z) {
        continue;
      }
      if (node >= leaves_) {
        if (visit(node - leaves_)) return true;
      } else {
        stack[depth++] = 2 * node + 1;
        stack[depth++] = 2 * node;
      }
    }
    return false;
  }

  // The closest point of the surface within `reach` of p and its triangle; false where there is none.
  bool closest(const Vec3& p, double reach, Vec3& point, std::uint32_t& triangle) const;
  // A point of the surface straight above or below p, within `reach`: on the triangle that is passed in where p is
  // over that, else the closest point of all.
  bool near(const Vec3& p, double reach, Vec3& point, std::uint32_t& triangle) const;

 private:
  friend struct SessionFields;  // session_state.cpp

  struct Box {
    Vec3 low, high;
  };
  std::vector<SweptTriangle> triangles_;
  std::vector<Box>
      boxes_;  // a heap: the children of i are 2 i and 2 i + 1; boxes_[leaves_ + i] is triangle i's
  std::uint32_t leaves_ = 0;  // a power of two
};

}  // namespace incise::core
