#include "server/core/cut/conforming/islands.hpp"

#include <algorithm>
#include <cmath>

namespace incise::core {

using namespace tolerance;

// Amid its vertices off the surface: the barycentre of one that lies in a bend may be beyond it.
Vec3 reference_point(const CutContext& cut, TetId t) {
  Vec3 sum{};
  int count = 0;
  for (VertexId v : cut.mesh.vertices(t)) {
    if (cut.on_surface(v)) continue;
    sum += cut.mesh.position(v);
    ++count;
  }
  return count == 0 ? cut.mesh.barycentre(t) : (1.0 / count) * sum;
}

bool is_shallow(const CutContext& cut, TetId t, double reach) {
  const TetMesh& mesh = cut.mesh;
  for (int f = 0; f < 4; ++f) {
    if (!(mesh.cut_mask(t) >> f & 1)) continue;
    // The middle is a quarter as far from a face as the apex.
    if (6 * mesh.volume(t) <= 4 * reach * length(mesh.twice_area(half_face(t, f)))) return true;
  }
  cut.work += cost::kNearby;
  return cut.surface().is_within(mesh.barycentre(t), reach);
}

bool may_be_film(const CutContext& cut, TetId t) {
  const TetMesh& mesh = cut.mesh;
  return std::ranges::all_of(mesh.vertices(t), [&](VertexId v) {
    if (mesh.at_boundary(v) || cut.on_surface(v)) return true;
    cut.work += cost::kSurfaceQuery;
    return cut.surface().is_within(mesh.position(v), kOne_h * cut.h);
  });
}

namespace {

// Whether a point is that near to a cut face of its tetrahedron.
bool is_near_own_cut(const TetMesh& mesh, TetId t, const Vec3& p, double reach) {
  for (int f = 0; f < 4; ++f) {
    if (!(mesh.cut_mask(t) >> f & 1)) continue;
    const Vec3 n = mesh.twice_area(half_face(t, f));
    if (std::abs(dot(n, p - mesh.position(mesh.face_vertices(half_face(t, f))[0]))) <= reach * length(n))
      return true;
  }
  return false;
}

// Whether a cut is that near.
bool is_near_cut(const CutContext& cut, const Vec3& p, double reach, Cuts cuts) {
  cut.work += cost::kNearby;
  if (cut.surface().is_within(p, reach)) return true;
  if (cuts == Cuts::kThisStroke) return false;
  const TetMesh& mesh = cut.mesh;
  const Vec3 r{reach, reach, reach};
  bool near = false;
  std::size_t looked_at = 0;
  cut.workspace.grid.visit_box(p - r, p + r, [&](TetId t) {
    ++looked_at;
    if (near || !mesh.alive(t) || mesh.cut_mask(t) == 0) return;
    cut.work += cost::kLook;
    for (int f = 0; f < 4; ++f) {
      if (!(mesh.cut_mask(t) >> f & 1)) continue;
      const auto v = mesh.face_vertices(half_face(t, f));
      const Vec3 q = closest_point(p, mesh.position(v[0]), mesh.position(v[1]), mesh.position(v[2]));
      near = near || squared_length(q - p) <= reach * reach;
    }
  });
  cut.work.add(looked_at, cost::kGridEntriesAUnit);
  return near;
}

}  // namespace

// By points amid a tetrahedron's quarters, and between these in one that is not much smaller than the volume in question. A rib is judged by the
// quarters alone.
bool is_deep(const CutContext& cut, std::span<const TetId> tets, double least_h3, Cuts cuts) {
  const TetMesh& mesh = cut.mesh;
  const double least_m3 = least_h3 * cut.h * cut.h * cut.h;
  const auto is_off = [&](TetId t, const Vec3& p) {
    return !is_near_own_cut(mesh, t, p, kDeep_h * cut.h) && !is_near_cut(cut, p, kDeep_h * cut.h, cuts);
  };
  double sum_m3 = 0;
  for (TetId t : tets) {
    const auto& v = mesh.vertices(t);
    const Vec3 middle = mesh.barycentre(t);
    const double volume_m3 = mesh.volume(t);
    int deep = 0, points = 4;
    for (VertexId w : v) deep += is_off(t, lerp(middle, mesh.position(w), 0.5));
    if (cuts == Cuts::kAll && volume_m3 > least_m3 / 4) {
      for (const auto& edge : kEdgeVertices) {
        const Vec3 there = lerp(mesh.position(v[edge[0]]), mesh.position(v[edge[1]]), 0.5);
        deep += is_off(t, lerp(middle, there, 0.5));
      }
      deep += is_off(t, middle);
      points = 11;
    }
    sum_m3 += volume_m3 * deep / points;
    if (sum_m3 >= least_m3) return true;
  }
  return false;
}

bool is_film(const CutContext& cut, const Extent& extent, std::span<const TetId> tets) {
  if (extent.volume_m3 <= extent.film_m3(cut.h)) return true;
  if (extent.volume_m3 > extent.shallow_m3(cut.h)) return false;
  const auto is_far = [&](TetId t) {
    return std::ranges::any_of(cut.mesh.vertices(t), [&](VertexId v) {
      const Vec3& p = cut.mesh.position(v);
      return !is_near_own_cut(cut.mesh, t, p, kFilmReach_h * cut.h) &&
             !is_near_cut(cut, p, kFilmReach_h * cut.h, Cuts::kAll);
    });
  };
  // What a sweep that is alone takes off is a part of the body where it reaches that far, however little of it does.
  if (!cut.meets_cut && std::ranges::any_of(tets, is_far)) return false;
  return !is_deep(cut, tets, extent.least_deep_h3(cut.h), Cuts::kAll);
}

void Islands::spare(HalfFace side) {
  cut_.work += cost::kLook;
  if (!pending(tet_of(side), face_of(side)) || stands_clear(side)) return;
  // What it stays with may be another one.
  while (is_island(tet_of(side))) {
    if (!join_larger_side()) return;
  }
  for (TetId t : members_) inland_.add(t);
}

// Whether what hangs together behind the faces that are about to open is no part of the tissue: a few tetrahedra with a face that is
// off the surface, a sheet near the surface, or a film all of whose vertices are at cuts and at the boundary.
bool Islands::is_island(TetId first) {
  seen_.begin();
  members_.assign(1, first);
  if (inland_.has(first)) return false;
  seen_.add(first);
  bool clean = true, thin = true;
  std::size_t inner = 0;
  Extent extent;
  for (std::size_t i = 0; i < members_.size(); ++i) {
    const TetId t = members_[i];
    thin = thin && is_thin(t);
    inner += may_be_film(cut_, t) ? 0 : 1;
    extent.volume_m3 += mesh_.volume(t);
    cut_.work += cost::kIslandMember;
    for (int f = 0; f < 4; ++f) {
      const HalfFace h = half_face(t, f);
      const TetId n = mesh_.neighbor(t, f);
      const bool opens = pending(t, f);
      if (opens || n == kNone) {
        clean = clean && (opens ? cut_.face_on_surface(h) : !is_ragged(h));
        extent.add_face(mesh_, h);
      } else if (!seen_.has(n)) {
        if (inland_.has(n)) return false;
        seen_.add(n);
        members_.push_back(n);
      }
    }
    const bool film = may_be_film(inner, members_.size());
    if (members_.size() > (thin || film ? kMaxSheetIsland : kMaxRaggedIsland)) return false;
  }
  const bool ragged =
      !clean && members_.size() <= kMaxRaggedIsland && !is_deep(cut_, members_, kLeastPart_h3, Cuts::kAll);
  const bool film = may_be_film(inner, members_.size());
  return ragged || thin || (film && is_film(cut_, extent, members_));
}

// Keeps the members together with their neighbours on one side of the surface: with both they would be a bridge. Nor with two
// that an older cut parts there: with those alone that hang together with one of them near by. False where there are none.
bool Islands::join_larger_side() {
  int above = 0, below = 0;
  const auto visit = [this](auto look) {
    for (TetId t : members_) {
      for (int f = 0; f < 4; ++f) {
        if (pending(t, f)) look(half_face(t, f));
      }
    }
  };
  visit([&](HalfFace h) { ++(is_above(h) ? above : below); });
  TetId first = kNone;
  double largest = 0;
  visit([&](HalfFace h) {
    const double area = squared_length(mesh_.twice_area(h));
    if (is_above(h) != (above >= below) || area <= largest) return;
    largest = area;
    first = tet_of(mesh_.opposite(h));
  });
  if (first == kNone) return false;
  reach_around(first);
  visit([&](HalfFace h) {
    const HalfFace o = mesh_.opposite(h);
    if (!seen_.has(tet_of(o)) || is_above(h) != (above >= below)) return;
    cut_.clear_pending(h);
    cut_.clear_pending(o);
  });
  return true;
}

// Marks what hangs together with a neighbour of the members, without them.
void Islands::reach_around(TetId first) {
  around_.assign(1, first);
  seen_.add(first);
  for (std::size_t i = 0; i < around_.size() && around_.size() < kMaxAround; ++i) {
    cut_.work += cost::kLook;
    for (int f = 0; f < 4; ++f) {
      const TetId n = mesh_.neighbor(around_[i], f);
      if (n != kNone && !pending(around_[i], f) && seen_.insert(n)) around_.push_back(n);
    }
  }
}

// Whether what is behind a face lies above the surface.
bool Islands::is_above(HalfFace h) const {
  Vec3 closest;
  std::uint32_t triangle = 0;
  return cut_.closest_on_surface(mesh_.face_middle(h), closest, triangle) &&
         cut_.surface()[triangle].signed_distance(reference_point(cut_, tet_of(mesh_.opposite(h)))) >= 0;
}

// Whether behind a face on the surface its tetrahedron reaches well away from it: the common case, no island.
bool Islands::stands_clear(HalfFace h) const {
  if (!cut_.face_on_surface(h) || mesh_.cut_mask(tet_of(h)) != 0) return false;
  const VertexId apex = mesh_.vertices(tet_of(h))[face_of(h)];
  // Between this sweep and an older one there may be a film.
  if (cut_.workspace.vertices[apex].surface != 0) return false;
  for (int f = 0; f < 4; ++f) {
    if (is_ragged(half_face(tet_of(h), f))) return false;
  }
  const Vec3 n = mesh_.twice_area(h);
  return std::abs(dot(n, mesh_.position(apex) - mesh_.position(mesh_.face_vertices(h)[0]))) >
         4 * kShallow_h * cut_.h * length(n);
}

// Whether a face has been opened off the surface, where a crossing could not be dealt with.
bool Islands::is_ragged(HalfFace h) const {
  if (!(mesh_.cut_mask(tet_of(h)) >> face_of(h) & 1)) return false;
  return !cut_.face_on_surface(h) &&
         std::ranges::any_of(mesh_.face_vertices(h), [this](VertexId v) { return cut_.failed(v); });
}

// Whether all of a tetrahedron is near the surface.
bool Islands::is_thin(TetId t) const {
  cut_.work += cost::kThin;
  return std::ranges::all_of(mesh_.vertices(t), [this](VertexId v) {
    return cut_.on_surface(v) || cut_.surface().is_within(mesh_.position(v), kThin_local * mesh_.local_h(v));
  });
}

}  // namespace incise::core
