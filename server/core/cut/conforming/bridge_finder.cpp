#include "server/core/cut/conforming/bridge_finder.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace incise::core {

using namespace tolerance;

void BridgeFinder::begin(HalfFace h) {
  face_ = h;
  faces_.clear();
  // Where a sweep ends, tissue goes round its rim: nearly all are told by little around them.
  look_around(0);
}

bool BridgeFinder::advance(WorkBudget& budget) {
  while (stage_ != Stage::kIdle) {
    cut_.work.charge(budget);
    if (budget.spent() || (cost_ahead() > 0 && cut_.part_is_full(cost_ahead()))) return false;
    step();
  }
  return true;
}

void BridgeFinder::look_around(std::size_t look) {
  const Vec3 middle = mesh_.face_middle(face_);
  look_ = look;
  grid_.lay_out(Box{middle, middle}.widened(kBridgeReach_h[look] * cut_.h), kBridgeStep_h * cut_.h);
  near_ = Box{middle, middle}.widened((kBridgeReach_h[0] + 0.5 * kBridgeStep_h) * cut_.h);
  pass_.begin();
  pass_.add(tet_of(face_));
  tets_.assign(1, tet_of(face_));
  go(Stage::kFill);
}

// A little of what is to be done.
void BridgeFinder::step() {
  const std::size_t points = grid_.size();
  const std::size_t end = std::min<std::size_t>(next_ + kChunk, points);
  switch (stage_) {
    case Stage::kLookFarther:
      look_around(look_ + 1);
      return;
    case Stage::kFill:
      fill(std::min<std::size_t>(next_ + kTetChunk, tets_.size()));
      if (next_ == tets_.size()) go(Stage::kBlock);
      return;
    case Stage::kBlock:
      grid_.block_swept();
      cut_.part_judging += grid_.swept().size() * cost::kPartBridgeQuad;
      // What has gone along with a body that moves is where it was swept to within an element or so.
      if (std::ranges::any_of(grid_.swept(),
                              [](const auto& swept) { return swept.quad->anchors[0].is_set(); }))
        return stop();
      roots_.resize(points);
      clear_.resize(points);
      deep_.resize(points);
      go(Stage::kUnite);
      return;
    case Stage::kUnite:
      unite(end, TissueGrid::kBlocked, roots_);
      if (end == points) go(Stage::kFindClear);
      return;
    case Stage::kFindClear:
      find_clear(end);
      if (end == points) go(Stage::kFindDeep);
      return;
    case Stage::kFindDeep:
      find_deep(end);
      if (end < points) return;
      list_parts();
      if (parts_.size() < 2) return go(Stage::kIdle);
      if (!is_last_look()) return go(Stage::kLookFarther);
      skin_roots_.resize(points);
      go(Stage::kUniteInSkin);
      return;
    case Stage::kUniteInSkin:
      unite(end, TissueGrid::kBlockedBySkin, skin_roots_);
      if (end == points) go(Stage::kPart);
      return;
    case Stage::kPart:
      part_all();
      go(Stage::kIdle);
      return;
    case Stage::kIdle:
      return;
  }
}

// All that hangs together with the face in the box.
void BridgeFinder::fill(std::size_t end) {
  for (; next_ < end; ++next_) {
    grid_.fill(tets_[next_], 1);
    cut_.work += cost::kFillTet;
    for (int f = 0; f < 4; ++f) {
      const HalfFace o = mesh_.opposite(half_face(tets_[next_], f));
      if (o != kNone && pass_.insert(tet_of(o)) && grid_.box_of(tet_of(o)).meets(grid_.box()))
        tets_.push_back(tet_of(o));
    }
  }
}

std::uint32_t BridgeFinder::root_of(std::uint32_t at, std::vector<std::uint32_t>& roots) {
  while (roots[at] != at) at = roots[at] = roots[roots[at]];
  return at;
}

// By point: one of those that open ways connect it with, the first one in the end.
void BridgeFinder::unite(std::size_t end, unsigned blocked_by, std::vector<std::uint32_t>& roots) {
  const std::vector<std::uint8_t>& sides = grid_.sides();
  cut_.work.add(end - next_, cost::kBridgePointsAUnit);
  for (; next_ < end; ++next_) {
    const auto at = static_cast<std::uint32_t>(next_);
    roots[at] = at;
    if (sides[at] == 0) continue;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const std::size_t before = at - grid_.step(axis);
      if (sides[before] == 0 || grid_.is_blocked(before, axis, blocked_by)) continue;
      const std::uint32_t a = root_of(static_cast<std::uint32_t>(before), roots), b = root_of(at, roots);
      roots[std::max(a, b)] = std::min(a, b);
    }
  }
}

// What is clear is more than a step from the surfaces, along the axes, and what is deep two: beside the skin as well.
void BridgeFinder::find_clear(std::size_t end) {
  const auto by_surface = [&](std::size_t at, std::size_t axis) {
    return grid_.is_blocked(at, axis) && !grid_.is_blocked(at, axis, TissueGrid::kBlockedBySkin);
  };
  cut_.work.add(end - next_, cost::kBridgePointsAUnit);
  for (; next_ < end; ++next_) {
    clear_[next_] = 0;
    deep_[next_] = 0;
    if (grid_.sides()[next_] == 0) continue;
    bool is_clear = true;
    for (std::size_t axis = 0; axis < 3; ++axis)
      is_clear = is_clear && !by_surface(next_, axis) && !by_surface(next_ - grid_.step(axis), axis);
    clear_[next_] = is_clear;
  }
}

// Counts them by parts; before the last look what is clear near the face, for there may be nothing that is deep.
void BridgeFinder::find_deep(std::size_t end) {
  cut_.work.add(end - next_, cost::kBridgePointsAUnit);
  for (; next_ < end; ++next_) {
    if (clear_[next_] == 0) continue;
    if (is_deep(next_)) clear_[next_] = 2;
    if (is_last_look() ? clear_[next_] == 2 : near_.has(grid_.place(next_)))
      ++deep_[root_of(static_cast<std::uint32_t>(next_), roots_)];
  }
}

// Whether no surface is beside its neighbours, either.
bool BridgeFinder::is_deep(std::size_t at) const {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const std::size_t step = grid_.step(axis);
    if (!grid_.is_blocked(at, axis) && grid_.sides()[at + step] != 0 && clear_[at + step] == 0) return false;
    if (!grid_.is_blocked(at - step, axis) && grid_.sides()[at - step] != 0 && clear_[at - step] == 0)
      return false;
  }
  return true;
}

void BridgeFinder::list_parts() {
  parts_.clear();
  const double least = (is_last_look() ? kLeastPart_h3 : kLeastPartNear_h3) / std::pow(kBridgeStep_h, 3);
  for (std::uint32_t at = 0; at < deep_.size(); ++at) {
    if (deep_[at] >= least) parts_.push_back({at, deep_[at]});
  }
  std::stable_sort(parts_.begin(), parts_.end(),
                   [](const Part& a, const Part& b) { return a.deep > b.deep; });
  if (parts_.size() > kMostParts) parts_.resize(kMostParts);
}

// The largest is what the others come off from. What the skin parts, too, hangs together in no other way than as it grew.
void BridgeFinder::part_all() {
  for (Part& part : parts_) part.skin_root = root_of(part.root, skin_roots_);
  list_ways();
  label_tets();
  list_capacities();
  for (std::size_t part = 1; part < parts_.size(); ++part)
    part_from_others(static_cast<std::uint8_t>(part + 1));
}

// Through what reaches out of the box parts may hang together that nothing parts beyond: left out.
void BridgeFinder::list_ways() {
  std::erase_if(tets_, [&](TetId t) { return !is_inside(t); });
  std::sort(tets_.begin(), tets_.end());
  ways_.assign(4 * tets_.size(), Way{});
  for (std::uint32_t i = 0; i < tets_.size(); ++i) {
    for (int f = 0; f < 4; ++f) {
      const HalfFace o = mesh_.opposite(half_face(tets_[i], f));
      if (o == kNone) continue;
      const auto at = std::lower_bound(tets_.begin(), tets_.end(), tet_of(o));
      if (at == tets_.end() || *at != tet_of(o)) continue;
      const auto to = static_cast<std::uint32_t>(at - tets_.begin());
      Way& way = ways_[4 * i + static_cast<std::uint32_t>(f)];
      way.to = to;
      way.back = 4 * to + static_cast<std::uint32_t>(face_of(o));
    }
  }
}

// Wholly in the box.
bool BridgeFinder::is_inside(TetId t) const {
  const Box around = grid_.box_of(t);
  return grid_.box().has(around.low) && grid_.box().has(around.high);
}

// A large tetrahedron may lie deep in two, and is none's then.
void BridgeFinder::label_tets() {
  labels_.assign(tets_.size(), 0);
  for (std::size_t i = 0; i < tets_.size(); ++i) {
    bool in_two = false;
    grid_.each_point(tets_[i], [&](std::size_t at) {
      if (clear_[at] < 2) return;
      const auto part =
          std::ranges::find(parts_, root_of(static_cast<std::uint32_t>(at), roots_), &Part::root);
      if (part == parts_.end()) return;
      const auto label = static_cast<std::uint8_t>(part - parts_.begin() + 1);
      in_two = in_two || (labels_[i] != 0 && labels_[i] != label);
      labels_[i] = label;
    });
    if (in_two) labels_[i] = 0;
  }
}

// A face costs more the farther its vertices are off what was swept.
void BridgeFinder::list_capacities() {
  const double far_m = kBridgeFar_h * cut_.h, one_m2 = kOne_h * kOne_h * cut_.h * cut_.h;
  off_m2_.clear();
  for (TetId t : tets_) {
    for (VertexId v : mesh_.vertices(t)) off_m2_.push_back({v, far_m * far_m});
  }
  std::sort(off_m2_.begin(), off_m2_.end());
  off_m2_.erase(std::unique(off_m2_.begin(), off_m2_.end()), off_m2_.end());
  for (auto& [v, off_m2] : off_m2_) {
    const Vec3& p = mesh_.position(v);
    const Box around = Box::around({p}).widened(far_m);
    for (const TissueGrid::Swept& swept : grid_.swept()) {
      if (swept.around.meets(around)) off_m2 = std::min(off_m2, swept.quad->squared_distance(p));
    }
    cut_.work.add(grid_.swept().size(), cost::kWallsAUnit);
  }
  for (std::size_t i = 0; i < ways_.size(); ++i) {
    if (ways_[i].to == kNothing) continue;
    double most_m2 = 0;
    for (VertexId v : mesh_.face_vertices(face_of_way(i))) {
      const auto at = std::lower_bound(off_m2_.begin(), off_m2_.end(), std::pair{v, 0.0});
      most_m2 = std::max(most_m2, at->second);
    }
    ways_[i].capacity =
        most_m2 >= far_m * far_m ? kNeverOpens : static_cast<int>(std::lround(4 * (1 + most_m2 / one_m2)));
  }
}

// Takes the fewest and nearest faces that part one of the parts from the others: those between what can still be reached from it, once as much flows as can,
// and all else.
void BridgeFinder::part_from_others(std::uint8_t label) {
  for (Way& way : ways_) way.flow = 0;
  std::size_t flows = 0;
  for (std::uint32_t end = reach_others(label); end != kNothing; end = reach_others(label)) {
    if (++flows > kMostFlows) return;
    int most = kNeverOpens;
    for (std::uint32_t i = end; labels_[i] != label; i = through_[i] / 4)
      most = std::min(most, ways_[through_[i]].capacity - ways_[through_[i]].flow);
    if (most >= kNeverOpens) return;
    for (std::uint32_t i = end; labels_[i] != label; i = through_[i] / 4) {
      ways_[through_[i]].flow += most;
      ways_[ways_[through_[i]].back].flow -= most;
    }
  }
  const std::size_t before = faces_.size();
  for (std::uint32_t i : queue_) {
    for (std::uint32_t k = 4 * i; k < 4 * i + 4; ++k) {
      if (ways_[k].to != kNothing && reached_[ways_[k].to] == 0) faces_.push_back(face_of_way(k));
    }
  }
  // No way leads there for the other parts.
  for (std::size_t k = before; k < faces_.size(); ++k) close_way(faces_[k]);
}

// Follows what is not full from one of the parts. Returns where it comes to another one.
std::uint32_t BridgeFinder::reach_others(std::uint8_t label) {
  const std::uint32_t skin_root = parts_[label - 1u].skin_root;
  reached_.assign(tets_.size(), 0);
  through_.resize(tets_.size());
  queue_.clear();
  for (std::uint32_t i = 0; i < tets_.size(); ++i) {
    if (labels_[i] != label) continue;
    reached_[i] = 1;
    queue_.push_back(i);
  }
  for (std::size_t next = 0; next < queue_.size(); ++next) {
    cut_.work += cost::kLook;
    for (std::uint32_t k = 4 * queue_[next]; k < 4 * queue_[next] + 4; ++k) {
      const Way& way = ways_[k];
      if (way.to == kNothing || way.flow >= way.capacity || reached_[way.to] != 0) continue;
      reached_[way.to] = 1;
      through_[way.to] = k;
      if (labels_[way.to] != 0 && parts_[labels_[way.to] - 1u].skin_root == skin_root) return way.to;
      queue_.push_back(way.to);
    }
  }
  return kNothing;
}

void BridgeFinder::close_way(HalfFace h) {
  const auto at = std::lower_bound(tets_.begin(), tets_.end(), tet_of(h));
  Way& way = ways_[4 * static_cast<std::size_t>(at - tets_.begin()) + static_cast<std::size_t>(face_of(h))];
  ways_[way.back].to = kNothing;
  way.to = kNothing;
}

}  // namespace incise::core
