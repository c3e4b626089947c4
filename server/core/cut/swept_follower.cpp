#include "server/core/cut/swept_follower.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "server/core/geometry/clip.hpp"
#include "server/core/mesh/vertex_samples.hpp"
#include "server/core/stroke/rigid_motion.hpp"

namespace incise::core {
namespace {

// How far around a point vertices are looked for: the first one that has any.
constexpr std::array kReach_h = {0.25, 1.0, 4.0};
// Where there is none: so many of all vertices are looked at.
constexpr std::size_t kFarSamples = 512;
// Two points of a line that are nearer than this go together.
constexpr double kApart = 1e-3;
// Where two vertices near a point of a line have gone apart by more than this, and by this part of how far apart they were, as the lips of a cut that
// gapes do, it is not known where what was swept there is.
constexpr double kApart_h = 0.25, kStretch = 0.5;
// Of the tetrahedra that are looked at so many make a unit of work.
constexpr std::int64_t kTetsAUnit = 4;
// What it costs to move a line, in units.
constexpr std::int64_t kMove = 20;

}  // namespace

// Calls visit(line) for all lines from number `next` on, until it says false (false; `next` is that line).
template <class Visit>
bool SweptFollower::each_line(std::size_t& next, Visit visit) {
  const std::span<SweptMemory::Quad> quads = workspace_.swept.quads_to_move();
  for (; next < 2 * quads.size(); ++next) {
    SweptMemory::Quad& quad = quads[next / 2];
    Line line{&quad.from, &quad.anchors.front(), nullptr, nullptr};
    if (next % 2 == 1) {
      line = {&quad.to, &quad.anchors.back(), &quad.from, &quad.anchors.front()};
    } else if (next > 0) {
      // Quads that follow each other share a line.
      line.line_before = &quads[next / 2 - 1].to;
      line.anchor_before = &quads[next / 2 - 1].anchors.back();
    }
    if (!visit(line)) return false;
  }
  std::size_t first = 2 * quads.size();
  for (std::size_t i = 0; i < workspace_.ends.size(); ++i) {
    SweepEnd& end = workspace_.ends[i];
    for (; next < first + end.line_count; ++next) {
      const std::size_t k = next - first;
      Line line{&end.lines[k], &end.anchors[k], nullptr, nullptr};
      if (k > 0) {
        line.line_before = &end.lines[k - 1];
        line.anchor_before = &end.anchors[k - 1];
      }
      if (!visit(line)) return false;
    }
    first += end.line_count;
  }
  return true;
}

void SweptFollower::begin() {
  next_ = 0;
  moved_.clear();
}

bool SweptFollower::advance(WorkBudget& budget) {
  return each_line(next_, [&](const Line& line) {
    if (line.anchor->is_set()) return true;
    if (budget.spent()) return false;
    if (line.goes_on_from_before()) {
      *line.anchor = *line.anchor_before;
    } else {
      set(*line.anchor, *line.line, budget);
    }
    return true;
  });
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

void SweptFollower::find_near(const Vec3& p, LineAnchor::Point& point, WorkBudget& budget) {
  if (!look_near(p, budget)) look_anywhere(p, budget);
  for (std::size_t i = 0; i < near_.size(); ++i) point.near[i] = near_[i].vertex;
}

// The nearest vertices of the boundary, cuts included: what was swept has left one. False: there is none.
bool SweptFollower::look_near(const Vec3& p, WorkBudget& budget) {
  near_.clear();
  std::int64_t looked_at = 0;
  for (const double reach_h : kReach_h) {
    if (!near_.empty()) break;
    const double reach_m = reach_h * mesh_.mean_edge_length();
    const Vec3 reach{reach_m, reach_m, reach_m};
    workspace_.grid.visit_box(p - reach, p + reach, [&](TetId t) {
      ++looked_at;
      if (!mesh_.alive(t)) return;
      for (const VertexId v : mesh_.vertices(t)) consider(v, p);
    });
  }
  budget.charge(1 + looked_at / kTetsAUnit);
  return !near_.empty();
}

// Far from the tissue some of that is as good as the nearest.
void SweptFollower::look_anywhere(const Vec3& p, WorkBudget& budget) {
  each_vertex_sample(mesh_, kFarSamples, [&](VertexId v) { consider(v, p); });
  budget.charge(static_cast<std::int64_t>(kFarSamples) / kTetsAUnit);
}

// Takes v among the nearest of those that were considered.
void SweptFollower::consider(VertexId v, const Vec3& p) {
  const Near near{squared_length(mesh_.position(v) - p), v};
  if (near_.size() == LineAnchor::kVertices && !(near < near_.back())) return;
  const auto place = std::lower_bound(near_.begin(), near_.end(), near);
  if (place != near_.end() && place->vertex == v) return;
  near_.insert(place, near);
  if (near_.size() > LineAnchor::kVertices) near_.pop_back();
}

bool SweptFollower::work_out(std::span<const Vec3> places, WorkBudget& budget) {
  std::size_t next = moved_.size();
  return each_line(next, [&](const Line& line) {
    if (line.goes_on_from_before() && *line.anchor_before == *line.anchor) {
      moved_.push_back(Moved(moved_.back()));
      return true;
    }
    if (budget.spent()) return false;
    moved_.push_back({*line.line, *line.anchor});
    move(moved_.back().line, moved_.back().anchor, places);
    budget.charge(kMove);
    return true;
  });
}

void SweptFollower::note() {
  const double same_m = HeldFaces::kSame_h * mesh_.mean_edge_length();
  for (HeldFaces* held : {&workspace_.held, &workspace_.ribs, &workspace_.necks})
    held->leave_out_changed(mesh_, same_m);
}

void SweptFollower::follow() {
  bool any_torn = false;
  std::size_t next = 0;
  each_line(next, [&](const Line& line) {
    *line.line = moved_[next].line;
    *line.anchor = moved_[next].anchor;
    any_torn = any_torn || line.anchor->is_torn;
    return true;
  });
  // Where a cut gapes, what was swept is on neither of its sides.
  if (any_torn) {
    const auto is_torn = [](const auto& anchors) {
      return std::ranges::any_of(anchors, &LineAnchor::is_torn);
    };
    workspace_.swept.forget_if(is_torn);
    workspace_.ends.forget_if(is_torn);
  } else {
    workspace_.swept.enclose();
  }
  for (std::size_t i = 0; i < workspace_.ends.size(); ++i) workspace_.ends[i].enclose();
  for (HeldFaces* held : {&workspace_.held, &workspace_.ribs, &workspace_.necks}) held->note_middles(mesh_);
}

// A point goes as the vertices near both points would if they were rigid, and then by what those near it deviate from that, in the mean.
void SweptFollower::move(BladeLine& line, LineAnchor& anchor, std::span<const Vec3> places) const {
  std::array<Vec3, 2 * LineAnchor::kVertices> from, to;
  std::size_t known = 0;
  for (std::size_t i = 0; i < 2; ++i) {
    for (std::size_t k = 0; k < LineAnchor::kVertices; ++k) {
      const VertexId v = anchor.points[i].near[k];
      if (!is_there(v)) continue;
      from[known] = mesh_.position(v);
      to[known++] = places[v];
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
    anchor.is_torn = note_strain(point, places) || anchor.is_torn;
    Vec3 deviation{};
    double count = 0;
    for (const VertexId v : point.near) {
      if (!is_there(v)) continue;
      deviation += places[v] - motion(mesh_.position(v));
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
bool SweptFollower::note_strain(LineAnchor::Point& point, std::span<const Vec3> places) const {
  const double most_m = kApart_h * mesh_.mean_edge_length();
  bool torn = false;
  float* apart_m = point.apart_m.data();
  for (std::size_t i = 0; i < LineAnchor::kVertices; ++i) {
    for (std::size_t k = i + 1; k < LineAnchor::kVertices; ++k, ++apart_m) {
      const VertexId a = point.near[i], b = point.near[k];
      if (!is_there(a) || !is_there(b)) continue;
      const double now_m = distance(places[a], places[b]);
      *apart_m += static_cast<float>(now_m - distance(mesh_.position(a), mesh_.position(b)));
      const double by_m = std::abs(double{*apart_m}), at_first_m = std::max(0.0, now_m - double{*apart_m});
      torn = torn || !(by_m <= most_m + kStretch * at_first_m);
    }
  }
  return torn;
}

}  // namespace incise::core
