#include "server/core/cut/swept_follower.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "server/core/geometry/clip.hpp"
#include "server/core/stroke/rigid_motion.hpp"

namespace incise::core {
namespace {

// How far around a point vertices are looked for: the first one that has any.
constexpr std::array kReach_h = {0.25, 1.0, 4.0};
constexpr double kReachAll_h = 1e6;
// Two points of a line that are nearer than this go together.
constexpr double kApart = 1e-3;
// Where two vertices near a point of a line have gone apart by more than this, and by this part of how far apart they were, as the lips of a cut that
// gapes do, it is not known where what was swept there is.
constexpr double kApart_h = 0.25, kStretch = 0.5;
// Of the tetrahedra that are looked at so many make a unit of work.
constexpr std::int64_t kTetsAUnit = 4;

}  // namespace

// Calls visit(line, anchor) for all lines that have one.
template <class Visit>
void SweptFollower::each_line(Visit visit) {
  workspace_.swept.each_line(visit);
  workspace_.ends.each_line(visit);
}

bool SweptFollower::advance(WorkBudget& budget) {
  std::size_t at = 0;
  bool done = true;
  const BladeLine* line_before = nullptr;
  const LineAnchor* anchor_before = nullptr;
  each_line([&](const BladeLine& line, LineAnchor& anchor) {
    // Quads that follow each other share a line.
    if (at++ >= next_ && done) {
      if (!anchor.is_set()) {
        if (budget.spent()) {
          done = false;
          return;
        }
        if (line_before != nullptr && *line_before == line) {
          anchor = *anchor_before;
        } else {
          set(anchor, line, budget);
        }
      }
      next_ = at;
    }
    line_before = &line;
    anchor_before = &anchor;
  });
  return done;
}

void SweptFollower::set(LineAnchor& anchor, const BladeLine& line, WorkBudget& budget) {
  double first, last;
  if (!clip(line.heel, line.tip, {workspace_.grid.low(), workspace_.grid.high()}, first, last)) {
    first = 0;
    last = 1;
  }
  anchor.points[0].part = static_cast<float>(first);
  anchor.points[1].part = static_cast<float>(last);
  for (LineAnchor::Point& point : anchor.points)
    find_near(lerp(line.heel, line.tip, static_cast<double>(point.part)), point, budget);
}

// The vertices of the boundary, cuts included: what was swept has left one.
void SweptFollower::find_near(const Vec3& p, LineAnchor::Point& point, WorkBudget& budget) {
  near_.clear();
  std::int64_t looked_at = 0;
  const auto look = [&](double reach_m) {
    const Vec3 reach{reach_m, reach_m, reach_m};
    workspace_.grid.visit_box(p - reach, p + reach, [&](TetId t) {
      ++looked_at;
      if (!mesh_.alive(t)) return;
      for (const VertexId v : mesh_.vertices(t)) {
        const Near near{squared_length(mesh_.position(v) - p), v};
        if (near_.size() == LineAnchor::kVertices && !(near < near_.back())) continue;
        const auto place = std::lower_bound(near_.begin(), near_.end(), near);
        if (place != near_.end() && place->vertex == v) continue;
        near_.insert(place, near);
        if (near_.size() > LineAnchor::kVertices) near_.pop_back();
      }
    });
  };
  for (const double reach_h : kReach_h) {
    if (near_.empty()) look(reach_h * mesh_.mean_edge_length());
  }
  if (near_.empty()) look(kReachAll_h * mesh_.mean_edge_length());
  for (std::size_t i = 0; i < near_.size(); ++i) point.near[i] = near_[i].vertex;
  budget.charge(1 + looked_at / kTetsAUnit);
}

// Where the vertices near each line are: kNear for each, those that are gone left out.
void SweptFollower::note() {
  before_.clear();
  each_line([&](const BladeLine&, const LineAnchor& anchor) {
    for (const LineAnchor::Point& point : anchor.points) {
      for (const VertexId v : point.near) before_.push_back(is_there(v) ? mesh_.position(v) : Vec3{});
    }
  });
  const double same_m = HeldFaces::kSame_h * mesh_.mean_edge_length();
  for (HeldFaces* held : {&workspace_.held, &workspace_.ribs, &workspace_.necks})
    held->leave_out_changed(mesh_, same_m);
}

void SweptFollower::follow() {
  const Vec3* before = before_.data();
  BladeLine last_line, last_moved;
  LineAnchor last_anchor, last_moved_anchor;
  each_line([&](BladeLine& line, LineAnchor& anchor) {
    // Quads that follow each other share a line.
    if (before == before_.data() || line != last_line || anchor != last_anchor) {
      last_line = line;
      last_anchor = anchor;
      move(line, anchor, before);
      last_moved = line;
      last_moved_anchor = anchor;
    } else {
      line = last_moved;
      anchor = last_moved_anchor;
    }
    before += 2 * LineAnchor::kVertices;
  });
  // Where a cut gapes, what was swept is on neither of its sides.
  const auto is_torn = [](const auto& anchors) { return std::ranges::any_of(anchors, &LineAnchor::is_torn); };
  workspace_.swept.forget_if(is_torn);
  workspace_.ends.forget_if(is_torn);
  for (std::size_t i = 0; i < workspace_.ends.size(); ++i) workspace_.ends[i].enclose();
  for (HeldFaces* held : {&workspace_.held, &workspace_.ribs, &workspace_.necks}) held->note_middles(mesh_);
}

// A point goes as the vertices near both points would if they were rigid, and then by what those near it deviate from that, in the mean.
void SweptFollower::move(BladeLine& line, LineAnchor& anchor, const Vec3* before) const {
  std::array<Vec3, 2 * LineAnchor::kVertices> from, to;
  std::size_t known = 0;
  for (std::size_t i = 0; i < 2; ++i) {
    for (std::size_t k = 0; k < LineAnchor::kVertices; ++k) {
      const VertexId v = anchor.points[i].near[k];
      if (!is_there(v)) continue;
      from[known] = before[i * LineAnchor::kVertices + k];
      to[known++] = mesh_.position(v);
    }
  }
  if (known == 0) {
    anchor.points = {};
    return;
  }
  const RigidMotion motion = RigidMotion::fit({from.data(), known}, {to.data(), known});
  Vec3 ends[2];
  bool lost = false;
  for (std::size_t i = 0; i < 2; ++i) {
    LineAnchor::Point& point = anchor.points[i];
    const Vec3* const was = before + i * LineAnchor::kVertices;
    anchor.is_torn = note_strain(point, was) || anchor.is_torn;
    Vec3 deviation{};
    double count = 0;
    for (std::size_t k = 0; k < LineAnchor::kVertices; ++k) {
      if (!is_there(point.near[k])) continue;
      deviation += mesh_.position(point.near[k]) - motion(was[k]);
      ++count;
    }
    ends[i] = motion(lerp(line.heel, line.tip, static_cast<double>(point.part)));
    if (count > 0) ends[i] += (1 / count) * deviation;
    lost = lost || count == 0;
  }
  const double first = static_cast<double>(anchor.points[0].part),
               last = static_cast<double>(anchor.points[1].part);
  // Others are looked for the next time.
  if (lost) anchor.points = {};
  if (last - first < kApart || squared_length(ends[1] - ends[0]) == 0) {
    line = motion(line);
    return;
  }
  // It is stretched as the tissue is.
  const Vec3 whole = (1 / (last - first)) * (ends[1] - ends[0]);
  line.heel = ends[0] - first * whole;
  line.tip = ends[1] + (1 - last) * whole;
}

// Adds up how much each two vertices at a point have gone apart in this step: there and back is nothing. Whether they are farther apart now than tissue is
// stretched, or nearer.
bool SweptFollower::note_strain(LineAnchor::Point& point, const Vec3* before) const {
  const double most_m = kApart_h * mesh_.mean_edge_length();
  bool torn = false;
  float* apart_m = point.apart_m.data();
  for (std::size_t i = 0; i < LineAnchor::kVertices; ++i) {
    for (std::size_t k = i + 1; k < LineAnchor::kVertices; ++k, ++apart_m) {
      if (!is_there(point.near[i]) || !is_there(point.near[k])) continue;
      const double now_m = distance(mesh_.position(point.near[i]), mesh_.position(point.near[k]));
      *apart_m += static_cast<float>(now_m - distance(before[i], before[k]));
      const double by_m = std::abs(double{*apart_m}), at_first_m = std::max(0.0, now_m - double{*apart_m});
      torn = torn || !(by_m <= most_m + kStretch * at_first_m);
    }
  }
  return torn;
}

}  // namespace incise::core
