#include "server/core/cut/conforming/verify_stage.hpp"

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
  bool on[4];
  for (int i = 0; i < 4; ++i) on[i] = cut_.on_surface(v[i]);
  const FourPoints p(
      {mesh_.position(v[0]), mesh_.position(v[1]), mesh_.position(v[2]), mesh_.position(v[3])});
  cut_.surface().any_between(p, clear_m, [&](std::uint32_t index) {
    const SweptTriangle& triangle = cut_.surface()[index];
    double d[4];
    p.along(triangle.normal, triangle.offset, d);
    if (FourPoints::least(d) > clear_m || FourPoints::most(d) < -clear_m) return false;
    int above = 0, below = 0;
    for (int i = 0; i < 4; ++i) {
      above += d[i] > clear_m || (d[i] >= -clear_m && !on[i]);
      below += d[i] < -clear_m || (d[i] <= clear_m && !on[i]);
    }
    if (above == 0 || below == 0) return false;
    // What lies beside the triangle as a whole crosses it nowhere.
    for (int k = 0; k < 3; ++k) {
      double inside[4];
      p.along(triangle.inward[k], triangle.inward_offset[k], inside);
      if (FourPoints::most(inside) < -clear_m) return false;
    }
    for (const auto& edge : kEdgeVertices) {
      const int i = edge[0], j = edge[1];
      if (on[i] && on[j]) continue;
      // An end on the surface is where the edge meets it.
      if ((on[i] && std::abs(d[i]) <= clear_m) || (on[j] && std::abs(d[j]) <= clear_m)) continue;
      double at;
      if (!crosses(mesh_.position(v[i]), mesh_.position(v[j]), d[i], d[j], triangle, clear_m, at)) continue;
      clear = false;
      const double length_m = distance(mesh_.position(v[i]), mesh_.position(v[j]));
      if (cut_.meets_end(v[i], at, length_m) || cut_.meets_end(v[j], 1 - at, length_m)) {
        // What stands for the surface deals with it.
        if (cut_.stands(v[i]) || cut_.stands(v[j])) continue;
        // So near to it that it is on this part, too.
        if ((on[i] ? std::abs(d[i]) : std::abs(d[j])) <= kLiesAtCut_h * cut_.h) continue;
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
