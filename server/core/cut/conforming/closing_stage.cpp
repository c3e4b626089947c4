#include "server/core/cut/conforming/closing_stage.hpp"

#include <algorithm>
#include <cmath>

#include "server/core/cut/conforming/islands.hpp"

namespace incise::core {

using namespace tolerance;

void ClosingStage::begin(std::span<const HalfFace> opened) {
  opened_.assign(opened.begin(), opened.end());
  gaps_.clear();
  faces_.clear();
  pass_.begin();
  // Two numbers: at the boundary, and not.
  scan_ = cut_.workspace.next_serial();
  cut_.workspace.next_serial();
  go(Phase::kCollect);
}

bool ClosingStage::advance(WorkBudget& budget) {
  switch (phase_) {
    case Phase::kCollect:
      if (!collect(budget)) return false;
      std::sort(gaps_.begin(), gaps_.end());
      go(Phase::kJudge);
      return false;
    case Phase::kJudge:
      if (!judge(budget)) return false;
      go(Phase::kOpen);
      return false;
    case Phase::kOpen:
      return open(budget);
  }
  return true;
}

// The faces around the vertices of what has opened, and those that have waited.
bool ClosingStage::collect(WorkBudget& budget) {
  for (; next_ < opened_.size(); ++next_) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    for (VertexId v : mesh_.face_vertices(opened_[next_])) {
      mesh_.star(v, star_);
      cut_.work += cost::kLook;
      for (Corner c : star_) {
        if (!pass_.insert(tet_of(c))) continue;
        cut_.work += cost::kLook;
        for (int f = 0; f < 4; ++f) consider(half_face(tet_of(c), f));
      }
    }
  }
  waited_.swap(waiting_);
  for (const Waiting& w : waited_) {
    if (cut_.has_front && cut_.path.travel_m() < w.ripe_at_m) {
      waiting_.push_back(w);
      continue;
    }
    set_waits(w.face, false);
    if (mesh_.alive(tet_of(w.face))) consider(w.face);
  }
  waited_.clear();
  return true;
}

// A face near the blade is listed once, however often its neighbours open.
void ClosingStage::consider(HalfFace h) {
  const HalfFace o = mesh_.opposite(h);
  if (o == kNone || waits(h) || cut_.is_pending(h) || !all_at_boundary(h) || has_to_wait(h)) return;
  double off_m = 0;
  if (!may_close(h, off_m)) return;
  cut_.set_pending(h);
  cut_.set_pending(o);
  gaps_.push_back({off_m, h});
}

// Before the blade all hangs together that it is about to part.
bool ClosingStage::has_to_wait(HalfFace h) {
  if (!cut_.has_front) return false;
  const double far_m = kFar_h * cut_.h;
  const Vec3& p = mesh_.position(mesh_.face_vertices(h)[0]);
  const double d2 = squared_distance_to_segment(p, cut_.front.heel, cut_.front.tip);
  if (d2 >= far_m * far_m) return false;
  waiting_.push_back({h, cut_.path.travel_m() + far_m - std::sqrt(d2)});
  set_waits(h, true);
  return true;
}

// Whether all of a face is near the surface, but for what lies at an older cut, and its sides are on either side. Where none of it lies at an
// older cut it has to be nearer.
bool ClosingStage::may_close(HalfFace h, double& off_m) {
  const auto v = mesh_.face_vertices(h);
  const Vec3 middle = (1.0 / 3.0) * (mesh_.position(v[0]) + mesh_.position(v[1]) + mesh_.position(v[2]));
  if (!is_near(middle, off_m)) return false;
  const SweptTriangle& triangle = cut_.surface()[nearest_];
  const double a = triangle.signed_distance(reference_point(cut_, tet_of(h)));
  const double b = triangle.signed_distance(reference_point(cut_, tet_of(mesh_.opposite(h))));
  if ((a >= 0) == (b >= 0) && std::min(std::abs(a), std::abs(b)) > kBeside_h * cut_.h) return false;
  bool meets = false;
  for (VertexId w : v) {
    const bool older = cut_.stands(w) || (!cut_.on_surface(w) && at_older_cut(w));
    meets = meets || older;
    if (!older && !is_near(mesh_.position(w), off_m)) return false;
  }
  return meets || off_m <= kAtSkin_h * cut_.h;
}

bool ClosingStage::is_near(const Vec3& p, double& off_m) {
  Vec3 closest;
  cut_.work += cost::kNearby;
  nearest_ = 0;
  if (!cut_.surface().closest(p, kOne_h * cut_.h, closest, nearest_)) return false;
  off_m = std::max(off_m, distance(p, closest));
  return true;
}

bool ClosingStage::all_at_boundary(HalfFace h) {
  return std::ranges::all_of(mesh_.face_vertices(h), [this](VertexId v) { return at_boundary(v); });
}

bool ClosingStage::at_boundary(VertexId v) {
  std::uint32_t& mark = cut_.workspace.vertices[v].at_boundary;
  if (mark == scan_ || mark == scan_ + 1) return mark == scan_;
  cut_.work += cost::kLook;
  mesh_.star(v, corners_);
  const bool is = std::ranges::any_of(
      corners_, [this](Corner c) { return (mesh_.boundary_mask(tet_of(c)) & ~(1u << index_of(c))) != 0; });
  mark = is ? scan_ : scan_ + 1;
  return is;
}

bool ClosingStage::at_older_cut(VertexId v) {
  mesh_.star(v, corners_);
  return std::ranges::any_of(
      corners_, [this](Corner c) { return (mesh_.cut_mask(tet_of(c)) & ~(1u << index_of(c))) != 0; });
}

bool ClosingStage::judge(WorkBudget& budget) {
  while (next_ < gaps_.size()) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    const auto [off_m, h] = gaps_[next_++];
    const HalfFace o = mesh_.opposite(h);
    if (is_part(tet_of(h), tet_of(o), off_m) && is_part(tet_of(o), tet_of(h), off_m)) {
      faces_.push_back(h);
    } else {
      cut_.clear_pending(h);
      cut_.clear_pending(o);
    }
  }
  return true;
}

// Whether what hangs together with `from`, through faces that stay closed, is a part of the tissue without `other`: large, or at least
// no crumb.
bool ClosingStage::is_part(TetId from, TetId other, double off_m) {
  pass_.begin();
  pass_.add(from);
  queue_.assign(1, from);
  bool deep = false;
  for (std::size_t i = 0; i < queue_.size(); ++i) {
    const TetId t = queue_[i];
    cut_.work += cost::kLook;
    deep = deep || !is_shallow(cut_, t, kOne_h * cut_.h);
    for (int f = 0; f < 4; ++f) {
      const HalfFace o = mesh_.opposite(half_face(t, f));
      if (o == kNone || cut_.is_pending(o)) continue;
      if (tet_of(o) == other) return false;
      if (pass_.insert(tet_of(o))) queue_.push_back(tet_of(o));
    }
    if (queue_.size() > kMaxWay) return true;
  }
  return deep && off_m <= kSure_h * cut_.h;
}

bool ClosingStage::open(WorkBudget& budget) {
  while (next_ < faces_.size()) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    const std::size_t end = std::min(next_ + kOpenChunk, faces_.size());
    editor_.open(std::span<const HalfFace>(faces_.data() + next_, end - next_));
    next_ = end;
  }
  return true;
}

void ClosingStage::archive(Archive& io) {
  io.list(waiting_, 12, [&](Waiting& w) {
    io(w.face);
    io(w.ripe_at_m);
    io.demand(tet_of(w.face) < mesh_.tet_slots(), "a waiting face of no tetrahedron");
    if (io.reads() && !io.failed()) set_waits(w.face, true);
  });
}

}  // namespace incise::core
