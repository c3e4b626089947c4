#include "server/core/cut/conforming/repair_stage.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace incise::core {

using namespace tolerance;

bool RepairStage::advance(WorkBudget& budget) {
  while (repairing_ || next_changed_ < editor_.changed().size()) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    if (!repairing_) {
      take_next();
    } else if (next_poor_ < poor_.size()) {
      improve();
    } else {
      end_vertex();
    }
  }
  return true;
}

// Finds what is poor around the next vertex.
void RepairStage::take_next() {
  repaired_ = editor_.changed()[next_changed_++];
  const VertexId v = repaired_.vertex;
  cut_.work += cost::kLook;
  if (mesh_.vertex_tet(v) == kNone) return;
  cut_.gather(star_, v);
  if (mesh_.is_new(v)) merge_near(v);
  if (mesh_.vertex_tet(v) == kNone) return;
  poor_.clear();
  next_poor_ = 0;
  remedy_ = 0;
  cut_.work += static_cast<std::int64_t>(star_.corners().size());
  if (star_.worst_now() > kPoor) {
    for (const VertexStar::Corner& c : star_.corners()) note_poor(c.tet);
  }
  repairing_ = true;
}

void RepairStage::end_vertex() {
  repairing_ = false;
  // What its neighbours' repair moves may free it: again, after all others.
  const bool still_poor = std::ranges::any_of(poor_, [this](TetId t) { return is_poor(t); });
  if (still_poor && repaired_.times < kMaxRepeats)
    editor_.changed().push_back({repaired_.vertex, repaired_.times + 1});
}

bool RepairStage::is_poor(TetId t, double limit) const {
  return mesh_.alive(t) && mesh_.worst_dihedral(t) > limit;
}

// One remedy for the poor tetrahedron at work: moves one of its vertices after the other, while that helps; else flips,
// else collapses an edge, else takes it out where it is a film on the surface.
void RepairStage::improve() {
  const TetId t = poor_[next_poor_];
  cut_.work += cost::kLook;
  bool done = !is_poor(t);
  if (!done) {
    if (remedy_ < 4) {
      try_moving(mesh_.vertices(t)[remedy_]);
      ++remedy_;
      done = !is_poor(t);
    } else if (remedy_ == 4) {
      ++remedy_;
      done = try_flips(t);
    } else {
      try_collapses(t);
      if (is_poor(t, cut_.meets_cut ? kSnapFloor : kFilmKept) && is_film(t)) editor_.remove_film(t);
      done = true;
    }
  }
  if (!done) return;
  ++next_poor_;
  remedy_ = 0;
}

// Whether a tetrahedron has all vertices on the surface and is not flat only because that bends: like a flat one it is no part of
// what is cut, if it is thin.
bool RepairStage::is_film(TetId t) const {
  const auto& v = mesh_.vertices(t);
  if (!std::ranges::all_of(v, [this](VertexId w) { return cut_.on_surface(w); })) return false;
  double twice_area = 0;
  for (int f = 0; f < 4; ++f) twice_area = std::max(twice_area, length(mesh_.twice_area(half_face(t, f))));
  if (6 * mesh_.volume(t) > kFilm_local * mesh_.local_h(v[0]) * twice_area) return false;
  cut_.work += cost::kNearby;
  return cut_.surface().is_within(mesh_.barycentre(t), kFilmOff_h * cut_.h);
}

void RepairStage::try_moving(VertexId v) {
  // Poor tetrahedra share vertices: what did not help one of them does not help the next.
  std::uint32_t& tried = cut_.workspace.vertices[v].tried;
  if (cut_.on_rim(v) || tried == serial_) return;
  tried = serial_;
  cut_.gather(star_, v);
  Placement place{mesh_.position(v), star_.worst_now()};
  const double before = place.worst;
  Vec3 closest;
  std::uint32_t triangle = 0;
  const bool on = cut_.on_surface(v);
  // An older cut would be longer than its blade has been, though no tissue would be lost.
  if (!on && star_.ends_cut()) return;
  if (on && !cut_.surface().closest(place.target, kMoveOff_h * cut_.h, closest, triangle)) return;
  places_.look_around(star_, on, triangle, {kGood, -1}, place);
  if (cut_.meets_cut && place.worst > kSnapFloor)
    places_.look_around(star_, on, triangle, {kSnapFloor, -1, kNeedleLevels, kNeedleTurns}, place);
  if (place.worst >= before) return;
  editor_.move(star_, v, place.target);
  // A move that helps the worst tetrahedron may make others poor.
  if (place.worst <= kPoor) return;
  for (const VertexStar::Corner& c : star_.corners()) note_poor(c.tet);
}

// Takes it on, if it is poor.
void RepairStage::note_poor(TetId t) {
  if (poor_.size() < kMaxPoor && mesh_.worst_dihedral(t) > kPoor &&
      std::find(poor_.begin(), poor_.end(), t) == poor_.end())
    poor_.push_back(t);
}

bool RepairStage::try_flips(TetId t) {
  const auto made = flips_.improve(t);
  // Better than what was there may still be poor.
  for (TetId n : made) note_poor(n);
  return !made.empty();
}

void RepairStage::try_collapses(TetId t) {
  const auto vertices = mesh_.vertices(t);
  for (VertexId v : vertices) {
    if (std::ranges::none_of(vertices, [&](VertexId w) { return w != v && is_free_to_go(v, w); })) continue;
    mesh_.star(v, corners_);
    cut_.work.add(corners_.size(), cost::kStarCornersAUnit);
    bool gathered = false;
    for (VertexId w : vertices) {
      if (w == v || !may_merge(v, w)) continue;
      if (!std::exchange(gathered, true)) cut_.gather(star_, v);
      if (try_collapse(star_, t, v, w)) return;
    }
  }
}

// A vertex that came from a split often has another one near on the surface, or the end of the edge that could not be
// snapped: merging the two takes back the tetrahedra that the split cost.
// star_ is its star before, and after where it is still there.
void RepairStage::merge_near(VertexId v) {
  struct Candidate {
    double length;
    VertexId vertex;
    TetId tet;
  };
  Candidate nearest[kMaxMergeCandidates];
  int count = 0;
  for (std::size_t i = 0; i < star_.corners().size(); ++i) {
    const VertexStar::Corner& c = star_.corners()[i];
    for (int k = 0; k < 3; ++k) {
      const double l = distance(star_.position(), star_.point(i, k));
      if (l > kMerge_local * star_.local_h()) continue;
      bool known = false;
      for (int n = 0; n < count; ++n) known = known || nearest[n].vertex == c.others[k];
      if (known) continue;
      if (count == kMaxMergeCandidates && nearest[count - 1].length <= l) continue;
      int at = count < kMaxMergeCandidates ? count++ : kMaxMergeCandidates - 1;
      nearest[at] = {l, c.others[k], c.tet};
      for (; at > 0 && nearest[at].length < nearest[at - 1].length; --at)
        std::swap(nearest[at], nearest[at - 1]);
    }
  }
  for (int i = 0; i < count; ++i) {
    if (!mesh_.alive(nearest[i].tet) || mesh_.local_index(nearest[i].tet, v) < 0) continue;
    if (is_free_to_go(nearest[i].vertex, v)) {
      mesh_.star(nearest[i].vertex, corners_);
      cut_.work.add(corners_.size(), cost::kStarCornersAUnit);
      if (may_merge(nearest[i].vertex, v)) {
        cut_.gather(other_star_, nearest[i].vertex);
        if (try_collapse(other_star_, nearest[i].tet, nearest[i].vertex, v)) {
          cut_.gather(star_, v);
          continue;
        }
      }
    }
    if (try_collapse(star_, nearest[i].tet, v, nearest[i].vertex)) return;
  }
}

// Whether v is not bound to a place that w is not at, nor splits the chord of a bend.
bool RepairStage::is_free_to_go(VertexId v, VertexId w) const {
  return !cut_.on_rim(v) && !editor_.is_in_bend(v) && (!cut_.on_surface(v) || cut_.on_surface(w));
}

// Whether v, around which corners_ are, is free to go to w, and its tetrahedra stay good there: what fails most merges, looked at before all
// that these need is gathered.
bool RepairStage::may_merge(VertexId v, VertexId w) const {
  if (!is_free_to_go(v, w)) return false;
  const Vec3& target = mesh_.position(w);
  for (const Corner corner : corners_) {
    const auto& vertices = mesh_.vertices(tet_of(corner));
    const auto& others = kFaceVertices[index_of(corner)];
    const VertexId a = vertices[others[0]], b = vertices[others[1]], c = vertices[others[2]];
    if (a == w || b == w || c == w) continue;
    cut_.work += cost::kLook;
    if (worst_dihedral(target, mesh_.position(a), mesh_.position(b), mesh_.position(c)) > kGood) return false;
  }
  return true;
}

// Whether merging v into w, both on the surface, would make an edge cross it: that bends between them.
bool RepairStage::crosses_after(const VertexStar& star, VertexId v, VertexId w) const {
  Vec3 closest;
  std::uint32_t triangle = 0;
  if (!cut_.on_surface(v)) return false;
  const Vec3& target = mesh_.position(w);
  cut_.work += cost::kNearby;
  if (!cut_.surface().closest(star.position(), kOnSurface_h * cut_.h, closest, triangle)) return false;
  if (std::abs(cut_.surface()[triangle].signed_distance(target)) <= kOnSurface_h * cut_.h) return false;
  for (std::size_t i = 0; i < star.corners().size(); ++i) {
    for (int k = 0; k < 3; ++k) {
      const VertexId other = star.corners()[i].others[k];
      double at = 0;
      if (other == w || cut_.on_surface(other)) continue;
      if (cut_.find_crossing(target, true, star.point(i, k), false, triangle, at)) return true;
    }
  }
  return false;
}

// Merges v, whose star that is, into w where v is free to go there and its star stays good.
bool RepairStage::try_collapse(const VertexStar& star, TetId t, VertexId v, VertexId w) {
  if (!is_free_to_go(v, w)) return false;
  const Vec3& target = mesh_.position(w);
  if (!star.keeps_boundary(target)) return false;
  for (std::size_t i = 0; i < star.corners().size(); ++i) {
    const auto& others = star.corners()[i].others;
    if (others[0] == w || others[1] == w || others[2] == w) continue;
    cut_.work += cost::kLook;
    const double now = worst_dihedral(target, star.point(i, 0), star.point(i, 1), star.point(i, 2));
    if (now > kGood) return false;
    if (!mesh_.deformed()) continue;
    const std::array<VertexId, 4> after{w, others[0], others[1], others[2]};
    const auto& before = mesh_.vertices(star.corners()[i].tet);
    if (!(mesh_.rest_volume(after) >= TetMesh::kLeastAtRest * mesh_.rest_volume(before)) ||
        !TetMesh::is_fair_at_rest(mesh_.worst_dihedral_at_rest(after), mesh_.worst_dihedral_at_rest(before),
                                  now))
      return false;
  }
  if (crosses_after(star, v, w)) return false;
  cut_.work += cost::kTryCollapse;
  if (!mesh_.may_collapse(t, v, w)) return false;
  editor_.collapse(star, t, v, w);
  return true;
}

}  // namespace incise::core
