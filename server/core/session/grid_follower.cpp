#include "server/core/session/grid_follower.hpp"

#include <algorithm>
#include <cmath>

#include "server/core/session/in_chunks.hpp"

namespace incise::core {
namespace {

// A new grid is larger than the body by this part of its largest extent on all sides.
constexpr double kRoom = 0.25;
constexpr std::int64_t kQuarters = 1;  // of a unit, for a vertex or a tetrahedron

}  // namespace

void GridFollower::settle(const Step& step) {
  rebuilt_ = rebuilt_ || workspace_.grid.overgrown() || !workspace_.grid.anchored();
  if (step.moved.empty()) rebuilt_ = false;
  boundary_.clear();
  low_ = {INFINITY, INFINITY, INFINITY};
  high_ = {-INFINITY, -INFINITY, -INFINITY};
  pass_.begin();
  next_ = 0;
  phase_ = rebuilt_ ? Phase::kCollect : Phase::kFollow;
}

bool GridFollower::advance(const Step& step, WorkBudget& budget) {
  if (phase_ == Phase::kFollow) {
    if (!follow(step, budget)) return false;
    phase_ = Phase::kReady;
  }
  if (phase_ == Phase::kCollect) {
    if (!collect(step, budget)) return false;
    phase_ = Phase::kRebuild;
  }
  if (phase_ == Phase::kRebuild) {
    if (!rebuild(step, budget)) return false;
    phase_ = Phase::kReady;
  }
  return true;
}

void GridFollower::enter(BoundaryGrid& grid, const Step& step, TetId t) const {
  const auto& v = mesh_.vertices(t);
  const Vec3 corners[4] = {step.targets[v[0]], step.targets[v[1]], step.targets[v[2]], step.targets[v[3]]};
  grid.add_at(t, corners);
}

bool GridFollower::follow(const Step& step, WorkBudget& budget) {
  BoundaryGrid& grid = workspace_.grid;
  return in_chunks(next_, step.moved.size(), budget, kQuarters, [&](std::size_t i) {
    if (!grid.leaves_anchor(mesh_, step.moved[i], step.positions[i])) return;
    mesh_.star(step.moved[i], star_);
    for (const Corner corner : star_) {
      if (mesh_.boundary_mask(tet_of(corner)) != 0) enter(grid, step, tet_of(corner));
    }
  });
}

// Collects the tetrahedra on the boundary, in the order of the current grid, and a box around them.
bool GridFollower::collect(const Step& step, WorkBudget& budget) {
  const BoundaryGrid& old = workspace_.grid;
  const bool done = in_chunks(next_, old.entries(), budget, kQuarters, [&](std::size_t i) {
    const TetId t = old.entry(i);
    if (pass_.has(t) || !mesh_.alive(t) || mesh_.boundary_mask(t) == 0) return;
    pass_.add(t);
    boundary_.push_back(t);
    for (const VertexId v : mesh_.vertices(t)) extend(step.targets[v], low_, high_);
  });
  if (!done) return false;
  const Vec3 size = high_ - low_;
  const double room = kRoom * std::max({size.x, size.y, size.z});
  const Vec3 margin{room, room, room};
  fresh_ = BoundaryGrid(low_ - margin, high_ + margin, 2 * mesh_.mean_edge_length());
  return true;
}

bool GridFollower::rebuild(const Step& step, WorkBudget& budget) {
  const std::size_t count = boundary_.size();
  const bool done = in_chunks(next_, count + mesh_.vertex_slots(), budget, kQuarters, [&](std::size_t i) {
    if (i < count) {
      enter(fresh_, step, boundary_[i]);
    } else {
      fresh_.set_anchor(step.targets[i - count]);
    }
  });
  if (done) fresh_.built();
  return done;
}

void GridFollower::commit() {
  if (rebuilt_) std::swap(workspace_.grid, fresh_);
}

}  // namespace incise::core
