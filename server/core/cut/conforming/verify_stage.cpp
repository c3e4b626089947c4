#include "server/core/cut/conforming/verify_stage.hpp"

#include <bit>
#include <cmath>

#include "server/core/geometry/four_points.hpp"

namespace incise::core {

using namespace tolerance;

void VerifyStage::begin(int round) {
  next_ = 0;
  active_.begin_scan();
  crossings_.begin_collection();
  first_found_ = crossings_.size();
  if (round == 0) clear_.begin();
}

bool VerifyStage::advance(WorkBudget& budget) {
  while (next_ < active_.size()) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    ActiveSet::Entry& entry = active_[next_++];
    cut_.work += cost::kLook;
    const TetId t = entry.tet;
    if (!mesh_.alive(t) || clear_.has(t) || !active_.ripe(entry)) continue;
    cut_.work += cost::kVerify;
    if (collect_from(t)) clear_.add(t);
  }
  return true;
}

void VerifyStage::fail_found() {
  for (std::size_t i = first_found_; i < crossings_.size(); ++i) {
    editor_.fail(crossings_[i].a);
    editor_.fail(crossings_[i].b);
    crossings_[i].done = true;
    ++cut_.counts.failed;
  }
}

// Adds the crossings of the tetrahedron's edges. Returns true if there are none.
bool VerifyStage::collect_from(TetId t) {
  bool clear = true;
  const double clear_m = cut_.clear_m;
  const auto& v = mesh_.vertices(t);
  unsigned on = 0;  // bit i: vertex i lies on the surface
  for (unsigned i = 0; i < 4; ++i) on |= (cut_.on_surface(v[i]) ? 1u : 0u) << i;
  const FourPoints p(
      {mesh_.position(v[0]), mesh_.position(v[1]), mesh_.position(v[2]), mesh_.position(v[3])});
  cut_.surface().any_between(p, clear_m, [&](std::uint32_t index) {
    const SweptTriangle& triangle = cut_.surface()[index];
    double d[4];
    p.along(triangle.normal, triangle.offset, d);
    const unsigned above = FourPoints::above(d, clear_m), below = ~FourPoints::from(d, -clear_m) & 0xfu;
    // What is this near to the plane is on both sides of it, unless it lies on the surface.
    const unsigned amid = ~(above | below | on) & 0xfu;
    if ((above | amid) == 0 || (below | amid) == 0 || above == 0xfu || below == 0xfu) return false;
    // What lies beside the triangle as a whole crosses it nowhere.
    for (int k = 0; k < 3; ++k) {
      double inside[4];
      p.along(triangle.inward[k], triangle.inward_offset[k], inside);
      if (FourPoints::most(inside) < -clear_m) return false;
    }
    // An end on the surface is where the edge meets it.
    unsigned edges = 0x3fu & ~(kEdgeSets.within[on] | kEdgeSets.within[above] | kEdgeSets.within[below] |
                               kEdgeSets.at[on & ~(above | below)]);
    for (; edges != 0; edges &= edges - 1) {
      const int i = kEdgeVertices[std::countr_zero(edges)][0], j = kEdgeVertices[std::countr_zero(edges)][1];
      double at;
      if (!crosses(mesh_.position(v[i]), mesh_.position(v[j]), d[i], d[j], triangle, clear_m, at)) continue;
      clear = false;
      const double length_m = distance(mesh_.position(v[i]), mesh_.position(v[j]));
      if (cut_.meets_end(v[i], at, length_m) || cut_.meets_end(v[j], 1 - at, length_m)) {
        // What stands for the surface deals with it.
        if (cut_.stands(v[i]) || cut_.stands(v[j])) continue;
        // So near to it that it is on this part, too.
        if (std::abs((on >> i & 1u) != 0 ? d[i] : d[j]) <= kLiesAtCut_h * cut_.h) continue;
        // A vertex on another part of the surface is as near as can be had.
        editor_.fail(v[i]);
        editor_.fail(v[j]);
      } else {
        crossings_.add(v[i], v[j], t, index, at);
      }
    }
    return false;
  });
  return clear;
}

}  // namespace incise::core
