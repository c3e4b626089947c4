#include "server/core/stroke/swept_tree.hpp"

#include <utility>

namespace incise::core {

namespace {

// Which way the blade went that swept the triangle, across this normal.
Vec3 motion_of(const SweptTriangle& triangle, const Vec3& normal) {
  return normalized(cross(normal, triangle.corners[1] - triangle.corners[0]));
}

}  // namespace

void SweptTree::build(std::span<const SweptTriangle> triangles, std::size_t from, std::size_t same,
                      std::size_t visited) {
  triangles_ = triangles;
  from_ = static_cast<std::uint32_t>(from);
  visited_ = static_cast<std::uint32_t>(visited);
  std::size_t children = triangles.size() - from, same_children = same - from, levels = 0;
  for (std::size_t n = children; n > (levels == 0 ? 0u : 1u); ++levels) n = (n + kChildren - 1) / kChildren;
  levels_.resize(levels);
  const bool had_slabs = std::exchange(has_slabs_, levels > kLevelsOfBoxes);
  if (has_slabs_ != had_slabs) same_children = 0;
  if (levels == 0) return;
  if (same == from) {
    const SweptTriangle& first = triangles[from];
    const Vec3 motion = motion_of(first, first.normal);
    axes_ = {motion, first.normal, cross(motion, first.normal)};
  }
  for (std::size_t level = 0; level < levels; ++level) {
    std::vector<Node>& nodes = levels_[level];
    const std::size_t had = nodes.size();
    nodes.resize((children + kChildren - 1) / kChildren);
    for (std::size_t i = same_children / kChildren; i < nodes.size(); ++i) {
      // The first of them may have children that are as they were: with planes of their own, they cost the most.
      const std::size_t first = i < had ? std::max(kChildren * i, same_children) : kChildren * i;
      if (first == kChildren * i) nodes[i] = empty_node();
      for (std::size_t child = first; child < std::min(kChildren * (i + 1), children); ++child)
        set_child(nodes[i], static_cast<std::uint32_t>(child % kChildren), level, child);
    }
    children = nodes.size();
    same_children /= kChildren;
  }
  triangles_ = {};
  const Node& root = levels_.back().front();
  for (std::size_t axis = 0; axis < axes_.size(); ++axis) {
    low_[axis] = least(root.low[axis]);
    high_[axis] = most(root.high[axis]);
  }
}

// Nothing overlaps it, and nothing is near.
SweptTree::Node SweptTree::empty_node() {
  Node node;
  for (Lane& low : node.low) low = lane(INFINITY);
  for (Lane& high : node.high) high = lane(-INFINITY);
  for (Slab& slab : node.slabs) {
    for (Lane& normal : slab.normal) normal = lane(0);
    slab.below = lane(-INFINITY);
    slab.above = lane(INFINITY);
  }
  return node;
}

// `child`: a triangle, for the lowest level, or a node of the level below.
void SweptTree::set_child(Node& node, std::uint32_t k, std::size_t level, std::size_t child) const {
  if (level == 0) {
    const SweptTriangle& triangle = triangles_[from_ + child];
    double rounded_m = 0;
    for (const Vec3& corner : triangle.corners)
      rounded_m = std::max(rounded_m, kRoundedSum * farthest(corner));
    for (std::size_t axis = 0; axis < axes_.size(); ++axis) {
      double at[3];
      for (std::size_t i = 0; i < 3; ++i) at[i] = dot(axes_[axis], triangle.corners[i]);
      node.low[axis][k] = static_cast<float>(std::min({at[0], at[1], at[2]}) - rounded_m);
      node.high[axis][k] = static_cast<float>(std::max({at[0], at[1], at[2]}) + rounded_m);
    }
  } else {
    const Node& below = levels_[level - 1][child];
    for (std::size_t axis = 0; axis < axes_.size(); ++axis) {
      node.low[axis][k] = least(below.low[axis]);
      node.high[axis][k] = most(below.high[axis]);
    }
  }
  if (!has_slabs_ || level == 0 || level >= kLevelsWithSlabs) return;
  const std::size_t holds = std::size_t{1} << 2 * level, begin = from_ + child * holds;
  set_slabs(node, k, begin, std::min(begin + holds, triangles_.size()));
}

// Planes across the mean normal of these triangles, and across their motion.
void SweptTree::set_slabs(Node& node, std::uint32_t k, std::size_t begin, std::size_t end) const {
  const SweptTriangle& first = triangles_[begin];
  Vec3 sum{};
  for (std::size_t i = begin; i < end; ++i) {
    // A blade that goes back and forth turns the normals over.
    const Vec3& n = triangles_[i].normal;
    sum += dot(n, first.normal) < 0 ? -n : n;
  }
  const Vec3 normal = normalized(sum);
  const Vec3 axes[2] = {normal, motion_of(first, normal)};
  double below[2] = {INFINITY, INFINITY}, above[2] = {-INFINITY, -INFINITY}, largest = 0;
  for (std::size_t i = begin; i < end; ++i) {
    for (const Vec3& corner : triangles_[i].corners) {
      for (int a = 0; a < 2; ++a) {
        const double at = dot(axes[a], corner);
        below[a] = std::min(below[a], at);
        above[a] = std::max(above[a], at);
      }
      largest = std::max(largest, farthest(corner));
    }
  }
  for (int a = 0; a < 2; ++a) {
    Slab& slab = node.slabs[a];
    for (std::size_t axis = 0; axis < axes_.size(); ++axis)
      slab.normal[axis][k] = static_cast<float>(dot(axes_[axis], axes[a]));
    slab.below[k] = static_cast<float>(below[a] - kRoundedSum * largest);
    slab.above[k] = static_cast<float>(above[a] + kRoundedSum * largest);
  }
}

}  // namespace incise::core
