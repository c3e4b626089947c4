#include "server/core/cut/conforming/islands.hpp"

#include <algorithm>
#include <cmath>

namespace incise::core {

using namespace tolerance;

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
// off the surface, the tip of something slender that the surface passes close by, a sheet near the surface, or a film all of whose vertices
// are at cuts and at the boundary.
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
    inner += films_.may_be_film(t) ? 0 : 1;
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
  const bool ragged = !clean && members_.size() <= kMaxRaggedIsland &&
                      !films_.is_deep(members_, kLeastPart_h3, Films::Cuts::kAll);
  const bool film = may_be_film(inner, members_.size());
  return ragged || thin || is_tip(extent) || (film && films_.is_film(extent, members_));
}

// Whether the members are too few and too small for a part, and none of them has its middle well away from the surface.
bool Islands::is_tip(const Extent& extent) const {
  return members_.size() <= kMaxRaggedIsland && extent.is_crumb(cut_.h) &&
         std::ranges::all_of(members_, [this](TetId t) { return is_shallow(cut_, t, kDeep_h * cut_.h); });
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
    joined_ = true;
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

// Whether behind a face on the surface its tetrahedron reaches well away from it and into the body: the common case, no island.
bool Islands::stands_clear(HalfFace h) const {
  if (!cut_.face_on_surface(h) || mesh_.cut_mask(tet_of(h)) != 0) return false;
  const VertexId apex = mesh_.vertices(tet_of(h))[face_of(h)];
  // Between this sweep and an older one there may be a film.
  if (cut_.workspace.vertices[apex].surface != 0) return false;
  for (int f = 0; f < 4; ++f) {
    // A tip has the boundary around it.
    if (mesh_.neighbor(tet_of(h), f) == kNone || is_ragged(half_face(tet_of(h), f))) return false;
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
