#include <algorithm>
#include <cmath>

#include "server/core/cut/conforming/conforming_cutter.hpp"

// ConformingCutter, the quality of what it leaves: where a vertex may go, and what is done about poor tetrahedra.
namespace incise::core {

// The directions in which a vertex may move: within the boundary, along a crease of it, within the swept surface.
int ConformingCutter::freedom(const VertexStar& star, const Vec3* surface_normal, Vec3 (&basis)[3]) const {
  Vec3 normals[3];
  int fixed = 0;
  const auto fix = [&](Vec3 n, double least) {
    for (int i = 0; i < fixed; ++i) n = n - dot(n, normals[i]) * normals[i];
    const double l = length(n);
    if (fixed < 3 && l > least) normals[fixed++] = (1 / l) * n;
  };
  if (surface_normal != nullptr) fix(*surface_normal, 0);
  if (star.on_boundary()) {
    // Boundary faces within 20 degrees of a first one are a smooth patch. A vertex moves in the plane of its mean normal by
    // area: there the body wins on one face what it loses on others. More than one patch make a crease, or a corner.
    Vec3 firsts[3], sums[3]{};
    int patches = 0;
    for (const VertexStar::Wall& wall : star.walls()) {
      int k = 0;
      while (k < patches && dot(firsts[k], wall.normal) <= 0.94) ++k;
      if (k == 3) continue;
      if (k == patches) firsts[patches++] = wall.normal;
      sums[k] += wall.twice_area * wall.normal;
    }
    for (int k = 0; k < patches; ++k) fix(normalized(sums[k]), k == 0 ? 0.05 : 0.34);
  }
  if (fixed == 0) {
    basis[0] = {1, 0, 0};
    basis[1] = {0, 1, 0};
    basis[2] = {0, 0, 1};
    return 3;
  }
  if (fixed == 1) {
    const Vec3& n = normals[0];
    const Vec3 axis = std::abs(n.x) < 0.6 ? Vec3{1, 0, 0} : Vec3{0, 1, 0};
    basis[0] = normalized(cross(n, axis));
    basis[1] = cross(n, basis[0]);
    return 2;
  }
  if (fixed == 2) {
    basis[0] = cross(normals[0], normals[1]);
    return 1;
  }
  return 0;
}

// Looks around for a place where the star is better, from one where its worst measure is `placement.worst`: a
// pattern search that halves its step, until `goal` is reached. Keeps to the swept surface where told so, and to the
// boundary.
void ConformingCutter::search_placement(const VertexStar& star, bool on_surface, std::uint32_t triangle,
                                        double goal, double thickness, Placement& placement) {
  Vec3 basis[3];
  const int count = freedom(star, on_surface ? &surface_[triangle].normal : nullptr, basis);
  if (count == 0) return;
  double step = 0.25 * star.local_h();
  for (int level = 0; level < 3 && placement.worst > goal; ++level, step *= 0.5) {
    for (int turn = 0; turn < 2; ++turn) {
      const Vec3 origin = placement.target;
      bool better = false;
      for (int k = 0; k < 2 * count && placement.worst > goal; ++k) {
        Vec3 p = origin + (k % 2 == 0 ? step : -step) * basis[k / 2];
        if (on_surface) {
          Vec3 closest;
          work_ += 1;
          if (!surface_.near(p, 0.2 * star.local_h(), closest, triangle)) continue;
          p = closest;
        }
        if (!star.keeps_boundary(p)) continue;
        const double worst = worst_at(star, p, placement.worst, thickness);
        if (worst >= placement.worst) continue;
        std::uint32_t crossed;
        double t;
        // What is beside the surface stays on its side.
        if (!on_surface && find_crossing(star.position(), false, p, false, crossed, t)) continue;
        placement = {p, worst};
        better = true;
      }
      if (!better) break;
    }
  }
}

void ConformingCutter::begin_repairs() {
  repairing_ = false;
  repairs_ = ++workspace_.serial;
  phase_ = Phase::kRepair;
}

// Improves what is poor around the vertices that this batch has put on the surface.
void ConformingCutter::repair(WorkBudget& budget) {
  while (repairing_ || next_changed_ < changed_.size()) {
    charge(budget);
    if (budget.spent()) return;
    if (!repairing_) {
      begin_repair();
    } else if (next_poor_ < poor_.size()) {
      improve();
    } else {
      repairing_ = false;
      // What its neighbours' repair moves may free it: again, after all others.
      constexpr int kMostTimes = 2;
      const bool still_poor = std::ranges::any_of(
          poor_, [this](TetId t) { return mesh_.alive(t) && mesh_.worst_dihedral(t) > kGood; });
      if (still_poor && repaired_.times < kMostTimes)
        changed_.push_back({repaired_.vertex, repaired_.times + 1});
    }
  }
  phase_ = Phase::kVerify;
  next_active_ = 0;
}

// Takes the next vertex and finds what is poor around it.
void ConformingCutter::begin_repair() {
  repaired_ = changed_[next_changed_++];
  const VertexId v = repaired_.vertex;
  work_ += 1;
  if (mesh_.vertex_tet(v) == kNone) return;
  if (mesh_.is_new(v)) thin_out(v);
  if (mesh_.vertex_tet(v) == kNone) return;
  gather(star_, v);
  poor_.clear();
  next_poor_ = 0;
  remedy_ = 0;
  work_ += static_cast<std::int64_t>(star_.corners().size());
  for (const VertexStar::Corner& c : star_.corners()) note_poor(c.tet);
  repairing_ = true;
}

// One remedy for the poor tetrahedron at work: moves one of its vertices after the other, while that helps; else flips,
// else collapses an edge, else takes it out where it is a film on the surface.
void ConformingCutter::improve() {
  const TetId t = poor_[next_poor_];
  work_ += 1;
  const auto is_poor = [&] { return mesh_.alive(t) && mesh_.worst_dihedral(t) > kGood; };
  bool done = !is_poor();
  if (!done) {
    if (remedy_ < 4) {
      improve_by_moving(mesh_.vertices(t)[remedy_]);
      ++remedy_;
      done = !is_poor();
    } else if (remedy_ == 4) {
      ++remedy_;
      done = try_flips(t);
    } else {
      improve_by_collapse(t);
      if (is_poor() && is_film(t)) {
        stir(mesh_.vertices(t));
        remove_flat(t);
        ++counts_.repairs;
      }
      done = true;
    }
  }
  if (!done) return;
  ++next_poor_;
  remedy_ = 0;
}

// Whether a tetrahedron has all vertices on the surface and is not flat only because that bends: like a flat one it is no part of
// what is cut, if it is thin.
bool ConformingCutter::is_film(TetId t) const {
  constexpr double kFilm_h = 0.06;
  const auto& v = mesh_.vertices(t);
  if (!std::ranges::all_of(v, [this](VertexId w) { return on_surface(w); })) return false;
  double twice_area = 0;
  for (int f = 0; f < 4; ++f) twice_area = std::max(twice_area, length(mesh_.twice_area(half_face(t, f))));
  if (6 * mesh_.volume(t) > kFilm_h * mesh_.local_h(v[0]) * twice_area) return false;
  work_ += 2;
  return surface_.is_within(mesh_.barycentre(t), kFilm_h * h_);
}

void ConformingCutter::improve_by_moving(VertexId v) {
  // Poor tetrahedra share vertices: what did not help one of them does not help the next.
  if (on_rim(v) || workspace_.vertices[v].tried == repairs_) return;
  workspace_.vertices[v].tried = repairs_;
  gather(star_, v);
  Placement place{mesh_.position(v), star_.worst_now()};
  const double before = place.worst;
  Vec3 closest;
  std::uint32_t triangle = 0;
  const bool on = on_surface(v);
  if (on && !surface_.closest(place.target, 0.01 * h_, closest, triangle)) return;
  search_placement(star_, on, triangle, kGood, -1, place);
  if (place.worst >= before) return;
  mesh_.move_vertex(v, place.target);
  judge_again(star_, v);
  ++counts_.repairs;
  for (const VertexStar::Corner& c : star_.corners()) {
    stir(mesh_.vertices(c.tet));
    note_poor(c.tet);  // better for the worst may be worse for others, which then stand in its way
  }
}

// Takes it on, if it is poor.
void ConformingCutter::note_poor(TetId t) {
  constexpr std::size_t kMost = 32;
  if (poor_.size() < kMost && mesh_.worst_dihedral(t) > kPoor &&
      std::find(poor_.begin(), poor_.end(), t) == poor_.end())
    poor_.push_back(t);
}

// Something around these vertices has changed: moving them may be of use again.
void ConformingCutter::stir(std::span<const VertexId> vertices) {
  for (VertexId v : vertices) workspace_.vertices[v].tried = 0;
}

void ConformingCutter::improve_by_collapse(TetId t) {
  const auto vertices = mesh_.vertices(t);
  for (VertexId v : vertices) {
    if (on_rim(v)) continue;
    gather(star_, v);
    for (VertexId w : vertices) {
      if (w != v && try_collapse(star_, t, v, w)) return;
    }
  }
}

// Replaces the poor tetrahedron and some around it by others between the same vertices (Freitag and Ollivier-Gooch 1997,
// "Tetrahedral mesh improvement using swapping and smoothing"): an edge of it is removed, or a face of it gives way to an
// edge. Whatever the swept surface separates later has to stay apart, so edges and faces on it stay; all that shares a
// vertex off the surface lies on one side of it.
bool ConformingCutter::try_flips(TetId t) {
  const auto vertices = mesh_.vertices(t);
  for (const auto& edge : kEdgeVertices) {
    if (remove_edge(t, vertices[edge[0]], vertices[edge[1]])) return true;
  }
  for (int f = 0; f < 4; ++f) {
    if (flip_face(half_face(t, f))) return true;
  }
  return false;
}

// The ring around the edge is filled with triangles instead, each of which makes a tetrahedron with either end: those
// triangles whose worst tetrahedron is best (Klincsek 1980, "Minimal triangulations of polygonal domains").
bool ConformingCutter::remove_edge(TetId t, VertexId a, VertexId b) {
  constexpr std::size_t kMost = 7;
  if ((on_surface(a) && on_surface(b)) || on_rim(a) || on_rim(b)) return false;
  mesh_.ring(t, a, b, ring_);
  const std::size_t n = ring_.size();
  work_ += static_cast<std::int64_t>(n);
  if (n < 3 || n > kMost) return false;
  // The ring's vertices in order, so that (a, b, ring[i], ring[i+1]) has one orientation for all i.
  std::array<VertexId, kMost> ring{};
  double before = -1;
  for (std::size_t i = 0; i < n; ++i) {
    const TetId r = ring_[i], next = ring_[(i + 1) % n];
    before = std::max(before, mesh_.worst_dihedral(r));
    if (mesh_.region(r) != mesh_.region(t)) return false;
    ring[i] = kNone;
    for (VertexId v : mesh_.vertices(r)) {
      if (v != a && v != b && mesh_.local_index(next, v) >= 0 &&
          (n > 3 || mesh_.local_index(ring_[(i + 2) % n], v) < 0))
        ring[i] = v;
    }
    // An open ring lies on the boundary.
    if (ring[i] == kNone) return false;
  }
  const Vec3 &pa = mesh_.position(a), &pb = mesh_.position(b);
  const bool forward = signed_volume(pa, pb, mesh_.position(ring[0]), mesh_.position(ring[1])) > 0;
  if (!forward) std::reverse(ring.begin(), ring.begin() + static_cast<std::ptrdiff_t>(n));
  work_ += static_cast<std::int64_t>(n * n * (n - 2) / 4);
  // worst[i][j]: of the best triangles for the ring's part from i to j, of which (i, apex[i][j], j) is one.
  double worst[kMost][kMost];
  std::size_t apex[kMost][kMost];
  for (std::size_t i = 0; i + 1 < n; ++i) worst[i][i + 1] = -1;
  for (std::size_t span = 2; span < n; ++span) {
    for (std::size_t i = 0; i + span < n; ++i) {
      const std::size_t j = i + span;
      worst[i][j] = before;
      apex[i][j] = n;
      const Vec3 &p = mesh_.position(ring[i]), &r = mesh_.position(ring[j]);
      for (std::size_t k = i + 1; k < j; ++k) {
        double made = std::max(worst[i][k], worst[k][j]);
        if (made >= worst[i][j]) continue;
        const Vec3& q = mesh_.position(ring[k]);
        made = std::max({made, worst_dihedral(pa, p, q, r), worst_dihedral(p, q, r, pb)});
        if (made >= worst[i][j]) continue;
        worst[i][j] = made;
        apex[i][j] = k;
      }
    }
  }
  if (apex[0][n - 1] == n) return false;
  std::array<std::array<VertexId, 4>, 2 * (kMost - 2)> added;
  std::size_t count = 0;
  const auto add = [&](const auto& self, std::size_t i, std::size_t j) -> void {
    if (j - i < 2) return;
    const std::size_t k = apex[i][j];
    added[count++] = {a, ring[i], ring[k], ring[j]};
    added[count++] = {ring[i], ring[k], ring[j], b};
    self(self, i, k);
    self(self, k, j);
  };
  add(add, 0, n - 1);
  return replace(ring_, std::span(added.data(), count));
}

// Two to three.
bool ConformingCutter::flip_face(HalfFace h) {
  const HalfFace o = mesh_.opposite(h);
  if (o == kNone) return false;
  const auto face = mesh_.face_vertices(h);
  if (on_surface(face[0]) && on_surface(face[1]) && on_surface(face[2])) return false;
  const std::array<TetId, 2> two{tet_of(h), tet_of(o)};
  if (mesh_.region(two[0]) != mesh_.region(two[1])) return false;
  const VertexId a = mesh_.vertices(two[0])[face_of(h)], b = mesh_.vertices(two[1])[face_of(o)];
  work_ += 12;
  if (mesh_.find_edge(a, b) != kNone) return false;
  const double before = std::max(mesh_.worst_dihedral(two[0]), mesh_.worst_dihedral(two[1]));
  std::array<std::array<VertexId, 4>, 3> added;
  for (std::size_t i = 0; i < 3; ++i) {
    // Seen from a, the face is clockwise, since it is counter-clockwise from outside its tetrahedron.
    added[i] = {a, b, face[i], face[(i + 1) % 3]};
    if (worst_dihedral(mesh_.position(a), mesh_.position(b), mesh_.position(face[i]),
                       mesh_.position(face[(i + 1) % 3])) >= before)
      return false;
  }
  return replace(two, added);
}

bool ConformingCutter::replace(std::span<const TetId> removed,
                               std::span<const std::array<VertexId, 4>> added) {
  work_ += 20;
  if (!mesh_.replace(removed, added, new_tets_)) return false;
  workspace_.grow(mesh_);
  for (TetId t : new_tets_) {
    if (mesh_.boundary_mask(t) != 0) workspace_.grid.add(mesh_, t);
    activate(t);
    stir(mesh_.vertices(t));
    note_poor(t);  // better than what was there may still be poor
  }
  ++counts_.repairs;
  return true;
}

// A vertex that came from a split often has another one near on the surface, or the end of the edge that could not be
// snapped: merging the two takes back the tetrahedra that the split cost.
void ConformingCutter::thin_out(VertexId v) {
  gather(star_, v);
  struct Candidate {
    double length;
    VertexId vertex;
    TetId tet;
  };
  Candidate nearest[4];
  int count = 0;
  for (std::size_t i = 0; i < star_.corners().size(); ++i) {
    const VertexStar::Corner& c = star_.corners()[i];
    for (int k = 0; k < 3; ++k) {
      const double l = distance(star_.position(), star_.point(i, k));
      if (l > 0.8 * star_.local_h()) continue;
      bool known = false;
      for (int n = 0; n < count; ++n) known = known || nearest[n].vertex == c.others[k];
      if (known) continue;
      if (count == 4 && nearest[3].length <= l) continue;
      int at = count < 4 ? count++ : 3;
      nearest[at] = {l, c.others[k], c.tet};
      for (; at > 0 && nearest[at].length < nearest[at - 1].length; --at)
        std::swap(nearest[at], nearest[at - 1]);
    }
  }
  for (int i = 0; i < count; ++i) {
    if (!mesh_.alive(nearest[i].tet) || mesh_.local_index(nearest[i].tet, v) < 0) continue;
    gather(other_star_, nearest[i].vertex);
    if (try_collapse(other_star_, nearest[i].tet, nearest[i].vertex, v)) {
      gather(star_, v);
      continue;
    }
    if (try_collapse(star_, nearest[i].tet, v, nearest[i].vertex)) return;
  }
}

// Merges v, whose star that is, into w where v is free to go there and its star stays good.
bool ConformingCutter::try_collapse(const VertexStar& star, TetId t, VertexId v, VertexId w) {
  if (on_rim(v) || (on_surface(v) && !on_surface(w))) return false;
  const Vec3& target = mesh_.position(w);
  if (!star.keeps_boundary(target)) return false;
  double worst = -1;
  for (std::size_t i = 0; i < star.corners().size(); ++i) {
    const auto& others = star.corners()[i].others;
    if (others[0] == w || others[1] == w || others[2] == w) continue;
    work_ += 1;
    worst = std::max(worst, worst_dihedral(target, star.point(i, 0), star.point(i, 1), star.point(i, 2)));
    if (worst > kGood) return false;
  }
  work_ += 40;
  if (!mesh_.may_collapse(t, v, w)) return false;
  mesh_.ring(t, v, w, ring_);
  for (TetId& r : ring_) r = mesh_.neighbor(r, mesh_.local_index(r, v));
  mesh_.collapse(t, v, w);
  const auto enter = [this](TetId changed) {
    if (mesh_.boundary_mask(changed) != 0) workspace_.grid.add(mesh_, changed);
  };
  // What lay across from v may lie at the boundary now.
  for (TetId r : ring_) {
    if (r != kNone) enter(r);
  }
  for (const VertexStar::Corner& c : star.corners()) {
    if (!mesh_.alive(c.tet)) continue;
    look_again(c.tet);
    activate(c.tet);
    enter(c.tet);
    stir(mesh_.vertices(c.tet));
  }
  ++counts_.repairs;
  return true;
}

}  // namespace incise::core
