#include "server/core/cut/conforming/verify_stage.hpp"

namespace incise::core {

void VerifyStage::begin(bool first) {
  next_ = 0;
  active_.begin_scan();
  crossings_.begin_collection();
  first_found_ = crossings_.size();
  seen_.begin_round(cut_.workspace.next_serial());
  if (!first) return;
  clear_.begin();
  seen_.begin_batch(clear_.serial());
}

bool VerifyStage::advance(WorkBudget& budget) {
  while (next_ < active_.size()) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    active_.fetch_ahead(next_);
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
  const auto& v = mesh_.vertices(t);
  // Of a flat surface an edge meets nothing but its end that lies on it.
  unsigned on = 0, flat = 0;
  for (unsigned i = 0; i < 4; ++i) {
    if (!cut_.on_surface(v[i])) continue;
    on |= 1u << i;
    flat |= (cut_.surface().is_in_all_planes(mesh_.position(v[i]), cut_.clear_m) ? 1u : 0u) << i;
  }
  for (const auto& edge : kEdgeVertices) {
    const unsigned ends = 1u << edge[0] | 1u << edge[1];
    if ((on & ends) == ends || (flat & ends) != 0) continue;
    const VertexId a = v[edge[0]], b = v[edge[1]];
    const SeenEdges::Seen seen = seen_.look_up(a, b);
    const bool edge_clear =
        seen == SeenEdges::Seen::kNot ? collect_from(t, a, b) : seen == SeenEdges::Seen::kClear;
    if (seen == SeenEdges::Seen::kNot) seen_.add(a, b, edge_clear);
    clear = clear && edge_clear;
  }
  return clear;
}

// The same for one edge.
bool VerifyStage::collect_from(TetId t, VertexId a, VertexId b) {
  cut_.work += cost::kVerifyEdge;
  bool clear = true;
  const bool a_on = cut_.on_surface(a), b_on = cut_.on_surface(b);
  const Vec3 &p = mesh_.position(a), &q = mesh_.position(b);
  const double length_m = distance(p, q);
  cut_.any_crossing(p, a_on, q, b_on, [&](std::uint32_t index, double at) {
    clear = false;
    // Where it crosses by an end that lies on another part of the surface, that is as near as can be had.
    if (!cut_.meets_end(a, at, length_m) && !cut_.meets_end(b, 1 - at, length_m))
      crossings_.add(a, b, t, index, at);
    return false;
  });
  return clear;
}

}  // namespace incise::core
