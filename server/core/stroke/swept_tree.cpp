#include "server/core/stroke/swept_tree.hpp"

namespace incise::core {

void SweptTree::build(std::span<const SweptTriangle> triangles, std::size_t from, std::size_t same) {
  triangles_ = triangles;
  from_ = static_cast<std::uint32_t>(from);
  std::size_t children = triangles.size() - from, same_children = same - from, levels = 0;
  for (std::size_t n = children; n > (levels == 0 ? 0u : 1u); ++levels) n = (n + kChildren - 1) / kChildren;
  const bool had_slabs = has_slabs();
  levels_.resize(levels);
  if (has_slabs() != had_slabs) same_children = 0;
  for (std::size_t level = 0; level < levels; ++level) {
    std::vector<Node>& nodes = levels_[level];
    nodes.resize((children + kChildren - 1) / kChildren);
    for (std::size_t i = same_children / kChildren; i < nodes.size(); ++i) {
      nodes[i] = empty_node();
      for (std::uint32_t k = 0; k < kChildren && kChildren * i + k < children; ++k)
        set_child(nodes[i], k, level, kChildren * i + k);
    }
    children = nodes.size();
    same_children /= kChildren;
  }
  triangles_ = {};
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
    const double low[3] = {triangle.low.x, triangle.low.y, triangle.low.z};
    const double high[3] = {triangle.high.x, triangle.high.y, triangle.high.z};
    for (int axis = 0; axis < 3; ++axis) {
      node.low[axis][k] = static_cast<float>(low[axis] - kRounded * std::abs(low[axis]));
      node.high[axis][k] = static_cast<float>(high[axis] + kRounded * std::abs(high[axis]));
    }
  } else {
    const Node& below = levels_[level - 1][child];
    for (int axis = 0; axis < 3; ++axis) {
      const Lane &l = below.low[axis], &h = below.high[axis];
      node.low[axis][k] = std::min(std::min(l[0], l[1]), std::min(l[2], l[3]));
      node.high[axis][k] = std::max(std::max(h[0], h[1]), std::max(h[2], h[3]));
    }
  }
  if (!has_slabs() || level == 0 || level >= kLevelsWithSlabs) return;
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
  const Vec3 axes[2] = {normal, normalized(cross(normal, first.corners[1] - first.corners[0]))};
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
    slab.normal[0][k] = static_cast<float>(axes[a].x);
    slab.normal[1][k] = static_cast<float>(axes[a].y);
    slab.normal[2][k] = static_cast<float>(axes[a].z);
    slab.below[k] = static_cast<float>(below[a] - kRoundedSum * largest);
    slab.above[k] = static_cast<float>(above[a] + kRoundedSum * largest);
  }
}

}  // namespace incise::core
