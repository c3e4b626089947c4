#include "server/core/cut/conforming/crossing_stage.hpp"

#include <algorithm>

namespace incise::core {

using namespace tolerance;

void CrossingStage::begin(int round) {
  round_ = round;
  order_.clear();
  next_ordered_ = 0;
  sealed_ = false;
  ordered_ = false;
}

// Sorts those that need not wait any more.
bool CrossingStage::order(WorkBudget& budget) {
  while (next_ordered_ < crossings_.size()) {
    if (budget.spent()) return false;
    budget.charge(cost::kLook);
    const auto i = static_cast<std::uint32_t>(next_ordered_++);
    const Crossing& c = crossings_[i];
    if (!c.done && !cut_.hot(c.a) && !cut_.hot(c.b)) order_.push({c.nearness, c.a, c.b, i});
  }
  if (!sealed_) {
    order_.seal();
    sealed_ = true;
    in_turn_.clear();
  }
  while (!order_.empty()) {
    if (budget.spent()) return false;
    budget.charge(cost::kLook);
    in_turn_.push_back(order_.take().index);
  }
  ordered_ = true;
  pass_ = 0;
  next_in_turn_ = 0;
  retry_.clear();
  return true;
}

bool CrossingStage::advance(WorkBudget& budget) {
  if (!ordered_) {
    order(budget);
    return false;
  }
  for (;;) {
    while (next_in_turn_ < in_turn_.size()) {
      cut_.work.charge(budget);
      if (budget.spent()) return false;
      const std::size_t at = next_in_turn_++;
      fetch_ahead(at);
      handle(in_turn_[at]);
    }
    if (retry_.empty()) return true;
    ++pass_;
    in_turn_.swap(retry_);
    retry_.clear();
    next_in_turn_ = 0;
  }
}

// Those that come next lie anywhere along the cut, in no cache as a rule.
[[gnu::always_inline]] inline void CrossingStage::fetch_ahead(std::size_t at) {
  if (at + 6 >= in_turn_.size()) return;
  __builtin_prefetch(&crossings_[in_turn_[at + 6]]);
  const Crossing& soon = crossings_[in_turn_[at + 4]];
  __builtin_prefetch(&cut_.workspace.vertices[soon.a]);
  __builtin_prefetch(&cut_.workspace.vertices[soon.b]);
  mesh_.prefetch_position(soon.a);
  mesh_.prefetch_position(soon.b);
  const Crossing& next = crossings_[in_turn_[at + 2]];
  if (!cut_.on_surface(next.a) && !cut_.on_surface(next.b))
    mesh_.prefetch_star(next.at <= 0.5 ? next.a : next.b);
  const Crossing& first = crossings_[in_turn_[at + 1]];
  if (!cut_.on_surface(first.a) && !cut_.on_surface(first.b))
    mesh_.prefetch_around_first(first.at <= 0.5 ? first.a : first.b);
}

void CrossingStage::handle(std::uint32_t index) {
  crossings_[index].done = true;
  Crossing crossing = crossings_[index];
  cut_.work += cost::kLook;
  if (!still_crosses(crossing)) return;
  const VertexId a = crossing.a, b = crossing.b;
  if (cut_.config.prefer == Preference::kExact && std::min(crossing.at, 1 - crossing.at) > kExactNear_edge &&
      cut_.worst_after_split(crossing.tet, a, b, crossing.at, kExactFloor) <= kExactFloor) {
    split(crossing);
    return;
  }
  const Vec3 at = lerp(mesh_.position(a), mesh_.position(b), crossing.at);
  if (snap_well(crossing, at)) return;
  if (pass_ == 0) {
    crossings_[index].done = false;
    retry_.push_back(index);
    return;
  }
  make_do(crossing);
}

// Whether there is anything to deal with. Brings the crossing up to date.
bool CrossingStage::still_crosses(Crossing& crossing) {
  const VertexId a = crossing.a, b = crossing.b;
  const bool a_on = cut_.on_surface(a), b_on = cut_.on_surface(b);
  // Dealt with by a snap of one end, as a rule; verification finds the exceptions.
  if (round_ == 0 && (a_on || b_on)) return false;
  if (!mesh_.alive(crossing.tet) || mesh_.local_index(crossing.tet, a) < 0 ||
      mesh_.local_index(crossing.tet, b) < 0) {
    crossing.tet = mesh_.find_edge(a, b);
    cut_.work += cost::kFindEdge;
    if (crossing.tet == kNone) return false;
  }
  if (round_ == 0 && crossing.batch == cut_.batch) return true;
  const Vec3 &p = mesh_.position(a), &q = mesh_.position(b);
  const double length_m = distance(p, q);
  cut_.work += cost::kFindCrossing;
  // Where a hand goes to and fro, one part of the surface may cross it at an end, and another one amid.
  return cut_.any_crossing(p, a_on, q, b_on, [&](std::uint32_t i, double at) {
    if (cut_.meets_end(a, at, length_m) || cut_.meets_end(b, 1 - at, length_m)) return false;
    crossing.triangle = i;
    crossing.at = at;
    return true;
  });
}

// Snaps an end of the edge whose star is good then.
bool CrossingStage::snap_well(const Crossing& crossing, const Vec3& at) {
  const bool near_a = crossing.at <= 0.5;
  ends_[0] = near_a ? crossing.a : crossing.b;
  ends_[1] = near_a ? crossing.b : crossing.a;
  best_[0] = best_[1] = {};
  for (int i = 0; i < 2; ++i) {
    if (cut_.on_surface(ends_[i])) continue;
    best_[i] = places_.place(stars_[i], ends_[i], crossing, at, kGood, pass_ > 0);
    if (best_[i].worst > kGood) continue;
    if (editor_.tears_film(ends_[i], best_[i].target, places_.flat())) {
      best_[i] = {};
    } else {
      ++cut_.counts.events;
      editor_.snap(stars_[i], ends_[i], best_[i].target, best_[i].worst, places_.flat());
      return true;
    }
  }
  return false;
}

// The better of what can be had: a snap, or a split, or neither.
void CrossingStage::make_do(const Crossing& crossing) {
  const VertexId a = crossing.a, b = crossing.b;
  const bool exact = cut_.config.prefer == Preference::kExact;
  const double floor = exact ? kExactFloor : kFloor;
  int i = best_[1].worst < best_[0].worst ? 1 : 0;
  if (best_[i].worst > kSnapFloor && !exact) {
    // At a boundary that runs along the surface, that of an older cut above all, a split only makes splinters.
    for (int k = 0; k < 2; ++k) {
      if (!cut_.on_surface(ends_[k]) && places_.stay(stars_[k], best_[k]))
        i = best_[k].worst < best_[i].worst ? k : i;
    }
  }
  for (int k = 0; k < 2 && best_[i].worst < kInverted && tears_film(i, best_[i].target); ++k) {
    best_[i] = {};
    i = 1 - i;
  }
  const double by_split = best_[i].worst <= kSnapFloor || !cut_.may_add()
                              ? kInverted
                              : cut_.worst_after_split(crossing.tet, a, b, crossing.at, floor);
  if (!exact && best_[i].worst > kSnapFloor && by_split > kSnapFloor && take_as_met(crossing)) return;
  if (best_[i].worst <= kSnapFloor || (best_[i].worst <= by_split && best_[i].worst <= floor)) {
    ++cut_.counts.events;
    editor_.snap(stars_[i], ends_[i], best_[i].target);
  } else if (by_split <= floor) {
    split(crossing);
  } else {
    ++cut_.counts.events;
    editor_.fail(a);
    editor_.fail(b);
    ++cut_.counts.failed;
  }
}

// Whether a film would come off if an end went there.
bool CrossingStage::tears_film(int end, const Vec3& target) {
  cut_.worst_at(stars_[end], target, kInverted, kFlat_local * stars_[end].local_h(), flat_);
  return editor_.tears_film(ends_[end], target, flat_);
}

// What lies near enough to the crossing is as good as a needle there: an end on the surface, or else a boundary vertex, which
// stands for the surface where it is. Needles beget others wherever a hand comes by again.
bool CrossingStage::take_as_met(const Crossing& crossing) {
  const double met_m = kMetForNeedle_h * cut_.h;
  const double length_m = distance(mesh_.position(crossing.a), mesh_.position(crossing.b));
  if ((cut_.on_surface(crossing.a) && crossing.at * length_m < met_m) ||
      (cut_.on_surface(crossing.b) && (1 - crossing.at) * length_m < met_m))
    return true;
  for (int k = 0; k < 2; ++k) {
    const Vec3 here = stars_[k].position();
    if (cut_.on_surface(ends_[k]) || !places_.stands_for_needle(stars_[k]) || tears_film(k, here)) continue;
    ++cut_.counts.events;
    editor_.snap(stars_[k], ends_[k], here);
    return true;
  }
  return false;
}

void CrossingStage::split(const Crossing& crossing) {
  ++cut_.counts.events;
  editor_.split(crossing.tet, crossing.a, crossing.b, crossing.at);
}

}  // namespace incise::core
