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

void GridFollower::look_at(std::span<const VertexId> vertices, std::span<const Vec3> targets, const Vec3& low,
                           const Vec3& high) {
  const BoundaryGrid& grid = workspace_.grid;
  if (!grid.contains(low) || !grid.contains(high)) {
    for (const Vec3& target : targets) outside_ += grid.contains(target) ? 0 : 1;
  }
  if (rebuilt_) return;
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    if (grid.leaves_anchor(mesh_, vertices[i], targets[i])) leaving_.push_back(vertices[i]);
  }
}

void GridFollower::settle(const Step& step) {
  rebuilt_ = rebuilt_ || outside_ > 0;
  any_left_ = false;
  if (step.moved.empty()) {
    rebuilt_ = false;
  } else if (!rebuilt_) {
    workspace_.grid.give_anchors(mesh_);
  }
  all_boundary_.clear();
  low_ = {INFINITY, INFINITY, INFINITY};
  high_ = {-INFINITY, -INFINITY, -INFINITY};
  pass_.begin();
  left_.assign(mesh_.vertex_slots() / 64 + 1, 0);
  next_ = 0;
  phase_ = rebuilt_ ? Phase::kCollect : Phase::kLeave;
}

bool GridFollower::advance(const Step& step, WorkBudget& budget) {
  if (phase_ == Phase::kLeave) {
    if (!leave(step, budget)) return false;
    phase_ = any_left_ ? Phase::kFollow : Phase::kReady;
  }
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

void GridFollower::enter(BoundaryGrid& grid, const Step& step, TetId t, const std::array<VertexId, 4>& v) {
  const Vec3 corners[4] = {step.targets[v[0]], step.targets[v[1]], step.targets[v[2]], step.targets[v[3]]};
  grid.add_at(t, corners);
}

void GridFollower::enter_where_left(const Step& step, TetId t, const std::array<VertexId, 4>& v) {
  // All four are looked up at once.
  unsigned left = 0;
  for (const VertexId w : v) left |= static_cast<unsigned>(left_[w / 64] >> (w % 64) & 1);
  if (left != 0) enter(workspace_.grid, step, t, v);
}

// Marks the vertices that leave their anchors, which follow them.
bool GridFollower::leave(const Step& step, WorkBudget& budget) {
  return in_chunks(next_, leaving_.size(), budget, kQuarters, [&](std::size_t i) {
    const VertexId v = leaving_[i];
    if (!staying_.empty() && std::binary_search(staying_.begin(), staying_.end(), v)) return;
    if (!workspace_.grid.leaves_anchor(mesh_, v, step.targets[v])) return;
    any_left_ = true;
    left_[v / 64] |= std::uint64_t{1} << (v % 64);
    workspace_.grid.move_anchor(v, step.targets[v]);
  });
}

// Through the boundary, which is a small part of a large body, instead of through the marked vertices' stars.
bool GridFollower::follow(const Step& step, WorkBudget& budget) {
  if (step.all) {
    return step.all->visit_boundary(next_, budget, [&](TetId t, const std::array<VertexId, 4>& vertices) {
      enter_where_left(step, t, vertices);
    });
  }
  return in_chunks(next_, step.listed.size(), budget, kQuarters, [&](std::size_t i) {
    enter_where_left(step, step.listed[i], mesh_.vertices(step.listed[i]));
  });
}

// Collects the tetrahedra on the boundary, in the order of the current grid, and a box around them.
bool GridFollower::collect(const Step& step, WorkBudget& budget) {
  const BoundaryGrid& old = workspace_.grid;
  const bool done = in_chunks(next_, old.entries(), budget, kQuarters, [&](std::size_t i) {
    const TetId t = old.entry(i);
    if (pass_.has(t) || !mesh_.alive(t) || mesh_.boundary_mask(t) == 0) return;
    pass_.add(t);
    all_boundary_.push_back(t);
    for (const VertexId v : mesh_.vertices(t)) extend(step.targets[v], low_, high_);
  });
  if (!done) return false;
  const Vec3 size = high_ - low_;
  const double room = kRoom * std::max({size.x, size.y, size.z});
  const Vec3 margin{room, room, room};
  // A grid is rebuilt when it has more than twice what it began with.
  fresh_.begin_again(low_ - margin, high_ + margin, 2 * mesh_.mean_edge_length(), old.entries());
  return true;
}

bool GridFollower::rebuild(const Step& step, WorkBudget& budget) {
  const std::size_t count = all_boundary_.size();
  const bool done = in_chunks(next_, count + mesh_.vertex_slots(), budget, kQuarters, [&](std::size_t i) {
    if (i < count) {
      enter(fresh_, step, all_boundary_[i], mesh_.vertices(all_boundary_[i]));
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
