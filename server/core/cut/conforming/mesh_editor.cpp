#include "server/core/cut/conforming/mesh_editor.hpp"

#include <algorithm>
#include <array>

namespace incise::core {

using namespace tolerance;

// v was moved: the surface may cross other edges of its tetrahedra now, and which side of it they are on may be another.
// That matters where ragged faces open.
void MeshEditor::judge_again(const VertexStar& star, VertexId v) {
  const auto failed = [this](VertexId w) { return cut_.failed(w); };
  const bool at_v = failed(v);
  for (const VertexStar::Corner& c : star.corners()) {
    look_again(c.tet);
    if (!cut_.may_have_failed) continue;
    if (at_v || std::ranges::any_of(c.others, failed)) active_.add(c.tet);
  }
}

// v was moved, and is not on the surface: that may cross edges now of tetrahedra that it has not met, where v has come over the surface, past its rim too.
void MeshEditor::take_what_is_crossed(const VertexStar& star, VertexId v) {
  crossed_.clear();
  const auto batch_across = [&](VertexId w) {
    const auto known = std::ranges::find(crossed_, w, &std::pair<VertexId, std::uint32_t>::first);
    if (known != crossed_.end()) return known->second;
    crossed_.emplace_back(w, cut_.batch_across(v, w));
    return crossed_.back().second;
  };
  for (const VertexStar::Corner& c : star.corners()) {
    if (active_.has(c.tet)) continue;
    for (VertexId w : c.others) {
      const std::uint32_t batch = batch_across(w);
      if (batch != kNone) active_.add(c.tet, batch);
    }
  }
}

void MeshEditor::move_to(const VertexStar& star, VertexId v, const Vec3& target) {
  mesh_.move_vertex(v, target);
  ++cut_.workspace.vertices[v].moves;
  for (const VertexStar::Corner& c : star.corners()) cut_.others.offer(c.tet);
}

void MeshEditor::snap(const VertexStar& star, VertexId v, const Vec3& target) {
  const double worst = cut_.worst_at(star, target, kInverted, kFlat_local * star.local_h(), flat_);
  snap(star, v, target, worst, flat_);
}

void MeshEditor::snap(const VertexStar& star, VertexId v, const Vec3& target, double worst,
                      std::span<const TetId> flat) {
  move_to(star, v, target);
  cut_.put_on_surface(v);
  ++cut_.counts.snaps;
  // What has three vertices on the surface only now may have a face to open.
  for (const VertexStar::Corner& c : star.corners()) {
    if (cut_.on_surface(c.others[0]) + cut_.on_surface(c.others[1]) + cut_.on_surface(c.others[2]) >= 2)
      active_.add(c.tet);
  }
  judge_again(star, v);
  if (worst > kGood || !flat.empty()) changed_.push_back({v});
  // First what cannot stay, by which no film hangs: then what may stay is all that one may hang by.
  for (const bool may_stay : {false, true}) {
    for (TetId t : flat) {
      // It may have gone with another one.
      if (mesh_.alive(t) && (mesh_.worst_dihedral(t) <= kFloor) == may_stay) remove_flat(t, may_stay);
    }
  }
}

void MeshEditor::snap_to_rim(const VertexStar& star, VertexId v, const Vec3& target) {
  cut_.workspace.vertices[v].rim = cut_.stroke;
  snap(star, v, target);
}

void MeshEditor::stand(VertexId v) {
  if (cut_.on_surface(v)) return;
  cut_.put_on_surface(v);
  mesh_.star(v, star_);
  cut_.work += static_cast<std::int64_t>(star_.size());
  for (Corner c : star_) {
    const auto on =
        std::ranges::count_if(mesh_.vertices(tet_of(c)), [this](VertexId w) { return cut_.on_surface(w); });
    if (on >= 3) active_.add(tet_of(c));
  }
}

void MeshEditor::move(const VertexStar& star, VertexId v, const Vec3& target) {
  move_to(star, v, target);
  judge_again(star, v);
  if (!cut_.on_surface(v)) take_what_is_crossed(star, v);
  for (const VertexStar::Corner& c : star.corners()) may_move_again(mesh_.vertices(c.tet));
  ++cut_.counts.repairs;
}

VertexId MeshEditor::split(TetId tet, VertexId a, VertexId b, double t, NewVertex is) {
  mesh_.ring(tet, a, b, ring_);
  const TetId first = mesh_.tet_slots();
  const VertexId m = mesh_.split_edge(tet, a, b, t);
  cut_.work += cost::kSplit * static_cast<std::int64_t>(ring_.size());
  cut_.workspace.grow(mesh_);
  if (is == NewVertex::kOnSurface) cut_.put_on_surface(m);
  if (is == NewVertex::kInBend) {
    in_bend_.push_back(m);
  } else {
    changed_.push_back({m});
  }
  for (TetId r : ring_) {
    look_again(r);
    active_.add(r);
    note_made(r);
  }
  for (TetId n = first; n < mesh_.tet_slots(); ++n) {
    enter(n);
    active_.add(n);
    note_made(n);
  }
  ++cut_.counts.splits;
  return m;
}

void MeshEditor::split_fan(TetId tet, VertexId a, VertexId b, double t) {
  mesh_.ring(tet, a, b, ring_);
  const TetId first = mesh_.tet_slots();
  const VertexId m = mesh_.split_edge(tet, a, b, t);
  cut_.work += cost::kSplit * static_cast<std::int64_t>(ring_.size());
  cut_.workspace.grow(mesh_);
  if (cut_.on_surface(a) && cut_.on_surface(b)) cut_.put_on_surface(m);
  for (std::size_t i = 0; i < ring_.size(); ++i) {
    const TetId n = first + static_cast<TetId>(i);
    enter(n);
    if (active_.has(ring_[i])) active_.add(n);
    cut_.others.offer(ring_[i]);
    cut_.others.offer(n);
  }
  ++cut_.counts.splits;
}

void MeshEditor::collapse(const VertexStar& star, TetId t, VertexId v, VertexId w) {
  mesh_.ring(t, v, w, ring_);
  for (TetId& r : ring_) r = mesh_.neighbor(r, mesh_.local_index(r, v));
  mesh_.collapse(t, v, w);
  // What lay across from v may lie at the boundary now.
  for (TetId r : ring_) {
    if (r != kNone) enter(r);
  }
  for (const VertexStar::Corner& c : star.corners()) {
    if (!mesh_.alive(c.tet)) continue;
    look_again(c.tet);
    active_.add(c.tet);
    note_made(c.tet);
    enter(c.tet);
    may_move_again(mesh_.vertices(c.tet));
  }
  ++cut_.counts.repairs;
}

std::span<const TetId> MeshEditor::replace(std::span<const TetId> removed,
                                           std::span<const std::array<VertexId, 4>> added) {
  cut_.work += cost::kReplace;
  if (mesh_.deformed() && !keeps_rest(removed, added)) return {};
  if (!mesh_.replace(removed, added, new_tets_)) return {};
  cut_.workspace.grow(mesh_);
  for (TetId t : new_tets_) {
    enter(t);
    active_.add(t);
    note_made(t);
    may_move_again(mesh_.vertices(t));
  }
  ++cut_.counts.repairs;
  return new_tets_;
}

// Whether no tetrahedron would be inside out at rest, or next to it, in a body that is deformed now.
bool MeshEditor::keeps_rest(std::span<const TetId> removed,
                            std::span<const std::array<VertexId, 4>> added) const {
  double now = 0, at_rest = 0, before = -1;
  for (TetId t : removed) {
    before = std::max(before, mesh_.worst_dihedral_at_rest(mesh_.vertices(t)));
    now += mesh_.volume(t);
    at_rest += mesh_.rest_volume(mesh_.vertices(t));
  }
  return std::ranges::all_of(added, [&](const std::array<VertexId, 4>& v) {
    const Vec3 p[4] = {mesh_.position(v[0]), mesh_.position(v[1]), mesh_.position(v[2]),
                       mesh_.position(v[3])};
    return mesh_.rest_volume(v) * now >=
               TetMesh::kLeastAtRest * signed_volume(p[0], p[1], p[2], p[3]) * at_rest &&
           TetMesh::is_fair_at_rest(mesh_.worst_dihedral_at_rest(v), before,
                                    worst_dihedral(p[0], p[1], p[2], p[3]));
  });
}

// Whether a film hangs together with the rest by tetrahedra that a snap would leave too flat to be kept.
bool MeshEditor::tears_film(VertexId v, const Vec3& target, std::span<const TetId> flat) {
  too_flat_.clear();
  // There is none beside a sweep that is alone.
  if (!cut_.meets_cut) return false;
  for (TetId t : flat) {
    Vec3 p[4];
    const auto& vertices = mesh_.vertices(t);
    for (std::size_t i = 0; i < 4; ++i) p[i] = vertices[i] == v ? target : mesh_.position(vertices[i]);
    if (worst_dihedral(p[0], p[1], p[2], p[3]) > kFloor) too_flat_.push_back(t);
  }
  return !too_flat_.empty() && film_hangs_by(too_flat_);
}

// Takes out a tetrahedron that is part of the surface. `may_stay`: unless a film hangs by it alone.
void MeshEditor::remove_flat(TetId t, bool may_stay) {
  TetId neighbors[4];
  for (int f = 0; f < 4; ++f) neighbors[f] = mesh_.neighbor(t, f);
  if (may_stay && film_hangs_by({&t, 1})) return;
  const VertexId first_copy = mesh_.vertex_slots();
  const auto vertices = mesh_.vertices(t);
  bared_.insert(bared_.end(), vertices.begin(), vertices.end());
  mesh_.remove_tet(t);
  cut_.work += cost::kRemoveFlat;
  ++cut_.counts.removed_tets;
  cut_.workspace.grow(mesh_);
  for (TetId n : neighbors) {
    if (n == kNone || !mesh_.alive(n)) continue;
    enter(n);
    remove_crumb(n);
  }
  // What is poor may be at a copy now, of a vertex that was put on the surface before.
  for (VertexId copy = first_copy; copy < mesh_.vertex_slots(); ++copy) {
    changed_.push_back({copy});
    bared_.push_back(copy);
  }
}

// Whether a film hangs together with the rest by these alone. Nearly always what is beside them is seen to hang together around their edges.
bool MeshEditor::film_hangs_by(std::span<const TetId> flat) {
  if (std::ranges::all_of(flat, [&](TetId t) { return hangs_together_around(t, flat); })) return false;
  for (TetId t : flat) {
    for (int f = 0; f < 4; ++f) {
      const TetId n = mesh_.neighbor(t, f);
      if (n != kNone && std::ranges::find(flat, n) == flat.end() && is_film_without(flat, n)) return true;
    }
  }
  return false;
}

// Whether the neighbours of t hang together around its edges without `flat`.
bool MeshEditor::hangs_together_around(TetId t, std::span<const TetId> flat) {
  const auto is_flat = [flat](TetId n) { return std::ranges::find(flat, n) != flat.end(); };
  const auto& v = mesh_.vertices(t);
  std::array<TetId, 4> neighbors;
  unsigned all = 0;  // bit f: there is a neighbour behind face f
  for (unsigned f = 0; f < 4; ++f) {
    neighbors[f] = mesh_.neighbor(t, static_cast<int>(f));
    if (neighbors[f] == kNone) continue;
    if (is_flat(neighbors[f])) return false;
    all |= 1u << f;
  }
  // The faces opposite to two vertices meet at the edge between the others.
  const auto meet_around_edge = [&](unsigned f, unsigned g) {
    VertexId ends[2];
    int n = 0;
    for (unsigned i = 0; i < 4; ++i) {
      if (i != f && i != g) ends[n++] = v[i];
    }
    mesh_.ring(t, ends[0], ends[1], ring_);
    const bool is_closed =
        ring_.front() == t && (ring_.back() == neighbors[f] || ring_.back() == neighbors[g]);
    return is_closed && std::none_of(ring_.begin() + 1, ring_.end(), is_flat);
  };
  cut_.work += cost::kLook;
  unsigned together = all & (~all + 1);  // with the first one
  for (unsigned before = 0; before != together && together != all;) {
    before = together;
    for (unsigned f = 0; f < 4; ++f) {
      for (unsigned g = 0; g < 4; ++g) {
        const bool is_open = (together >> f & 1) != 0 && ((all & ~together) >> g & 1) != 0;
        if (is_open && meet_around_edge(f, g)) together |= 1u << g;
      }
    }
  }
  return together == all;
}

// Whether what n hangs together with is a film without some tetrahedra. Nearly always n reaches into the tissue, which is seen at once.
bool MeshEditor::is_film_without(std::span<const TetId> flat, TetId n) {
  films_.begin();
  film_.assign(1, n);
  film_pass_.begin();
  for (TetId t : flat) film_pass_.add(t);
  film_pass_.add(n);
  Extent extent;
  std::size_t inner = 0;
  for (std::size_t i = 0; i < film_.size(); ++i) {
    cut_.work += cost::kLook;
    inner += films_.may_be_film(film_[i]) ? 0 : 1;
    extent.volume_m3 += mesh_.volume(film_[i]);
    for (int f = 0; f < 4; ++f) {
      const HalfFace h = half_face(film_[i], f), o = mesh_.opposite(h);
      if (o == kNone) {
        extent.add_face(mesh_, h);
      } else if (film_pass_.insert(tet_of(o))) {
        film_.push_back(tet_of(o));
      }
    }
    if (film_.size() > kMaxSheetIsland || (i >= kMaxRaggedIsland && !may_be_film(inner, i + 1))) return false;
  }
  if (!may_be_film(inner, film_.size())) return false;
  if (!films_.is_film(extent, film_)) return false;
  return film_.size() > kMaxRaggedIsland || !is_crumb(film_);
}

// Whether all of them are near the surface, like a flat tetrahedron.
bool MeshEditor::is_crumb(std::span<const TetId> tets) const {
  return std::ranges::all_of(tets, [this](TetId t) { return is_shallow(cut_, t, kShallow_h * cut_.h); });
}

// What hung by a flat tetrahedron alone goes with it.
void MeshEditor::remove_crumb(TetId t) {
  crumb_.assign(1, t);
  for (std::size_t i = 0; i < crumb_.size(); ++i) {
    cut_.work += cost::kLook;
    if (!is_shallow(cut_, crumb_[i], kShallow_h * cut_.h)) return;
    for (int f = 0; f < 4; ++f) {
      const TetId n = mesh_.neighbor(crumb_[i], f);
      if (n != kNone && std::ranges::find(crumb_, n) == crumb_.end()) crumb_.push_back(n);
    }
    if (crumb_.size() > kMaxCrumb) return;
  }
  for (TetId c : crumb_) mesh_.remove_tet(c);
  cut_.counts.removed_tets += static_cast<std::uint32_t>(crumb_.size());
}

void MeshEditor::remove_film(TetId t) {
  may_move_again(mesh_.vertices(t));
  remove_flat(t, true);
  ++cut_.counts.repairs;
}

// The face is about to open: its area, and how far it is off the surface.
void MeshEditor::account(HalfFace h) {
  cut_.clear_pending(h);
  cut_.clear_pending(mesh_.opposite(h));
  cut_.counts.cut_area += 0.5 * length(mesh_.twice_area(h));
  for (VertexId v : mesh_.face_vertices(h)) {
    if (cut_.on_surface(v)) continue;
    std::uint32_t triangle;
    Vec3 closest = mesh_.position(v);
    cut_.work += cost::kDeviation;
    cut_.closest_on_surface(mesh_.position(v), closest, triangle);
    cut_.counts.max_deviation_h =
        std::max(cut_.counts.max_deviation_h, distance(closest, mesh_.position(v)) / cut_.h);
  }
}

void MeshEditor::open(std::span<const HalfFace> faces) {
  for (HalfFace h : faces) {
    account(h);
    cut_.workspace.grid.add(mesh_, tet_of(h));
    cut_.workspace.grid.add(mesh_, tet_of(mesh_.opposite(h)));
    cut_.others.offer(tet_of(h));
    cut_.others.offer(tet_of(mesh_.opposite(h)));
  }
  cut_.counts.cut_faces += mesh_.open_faces(faces);
  cut_.workspace.grow(mesh_);
  cut_.work += cost::kOpenFace * static_cast<std::int64_t>(faces.size());
}

void MeshEditor::fail(VertexId v) {
  if (cut_.failed(v)) return;
  cut_.may_have_failed = true;
  cut_.workspace.vertices[v].failed = cut_.stroke;
  mesh_.star(v, star_);
  cut_.work += static_cast<std::int64_t>(star_.size());
  for (std::uint32_t corner : star_) active_.add(tet_of(corner));
}

}  // namespace incise::core
