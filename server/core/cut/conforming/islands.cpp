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

void Islands::spare(HalfFace side) {
  cut_.work += cost::kLook;
  if (!pending(tet_of(side), face_of(side)) || stands_clear(side)) return;
  bool clean = true, thin = true, shallow = true;
  const bool island = collect(tet_of(side), clean, thin, shallow);
  if (island && (!clean || thin || shallow)) {
    join_larger_side();
  } else {
    for (std::size_t i = 0; i < size_; ++i) inland_.add(members_[i]);
  }
}

// The tetrahedra that hang together behind the faces that are about to open. Whether they are few enough for an island; `clean`:
// none of its faces is off the surface; `thin`: all of it is near the surface.
bool Islands::collect(TetId first, bool& clean, bool& thin, bool& shallow) {
  std::size_t max_size = kMaxSheetIsland;
  size_ = 1;
  members_[0] = first;
  bool island = !inland_.has(first);
  for (std::size_t i = 0; i < size_ && island; ++i) {
    const TetId t = members_[i];
    thin = thin && is_thin(t);
    shallow = shallow && is_shallow(cut_, t, kShallow_h * cut_.h) && reaches_no_farther(t);
    if (!thin && !shallow) max_size = kMaxRaggedIsland;
    cut_.work += cost::kIslandMember;
    for (int f = 0; f < 4; ++f) {
      if (pending(t, f)) {
        clean = clean && cut_.face_on_surface(half_face(t, f));
        continue;
      }
      const TetId n = mesh_.neighbor(t, f);
      if (n == kNone) {
        clean = clean && !is_ragged(half_face(t, f));
        continue;
      }
      if (std::find(members_, members_ + size_, n) != members_ + size_) continue;
      island = size_ < max_size && !inland_.has(n);
      if (!island) break;
      members_[size_++] = n;
    }
    island = island && size_ <= max_size;
  }
  return island;
}

// Keeps the members together with those of their neighbours that are on one side of the surface: with both they would
// be a bridge.
void Islands::join_larger_side() {
  int above = 0, below = 0;
  for (const bool decided : {false, true}) {
    for (TetId t : std::span(members_, size_)) {
      for (int f = 0; f < 4; ++f) {
        if (!pending(t, f)) continue;
        const HalfFace h = half_face(t, f), o = mesh_.opposite(h);
        const bool up = is_above(h);
        if (!decided) {
          ++(up ? above : below);
        } else if (up == (above >= below)) {
          cut_.clear_pending(h);
          cut_.clear_pending(o);
        }
      }
    }
  }
}

// Whether what is behind a face lies above the surface.
bool Islands::is_above(HalfFace h) const {
  const auto face = mesh_.face_vertices(h);
  const Vec3 middle =
      (1.0 / 3.0) * (mesh_.position(face[0]) + mesh_.position(face[1]) + mesh_.position(face[2]));
  Vec3 closest;
  std::uint32_t triangle = 0;
  return cut_.surface().closest(middle, kSurfaceReach_h * cut_.h, closest, triangle) &&
         cut_.surface()[triangle].signed_distance(reference_point(cut_, tet_of(mesh_.opposite(h)))) >= 0;
}

// Whether behind a face on the surface its tetrahedron reaches well away from it: the common case, no island.
bool Islands::stands_clear(HalfFace h) const {
  if (!cut_.face_on_surface(h) || mesh_.cut_mask(tet_of(h)) != 0) return false;
  const VertexId apex = mesh_.vertices(tet_of(h))[face_of(h)];
  if (cut_.on_surface(apex)) return false;
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

// Whether each vertex of a tetrahedron lies in a cut or near the surface.
bool Islands::reaches_no_farther(TetId t) const {
  const unsigned cut_faces = mesh_.cut_mask(t);
  for (unsigned i = 0; i < 4; ++i) {
    const VertexId v = mesh_.vertices(t)[i];
    if (cut_.on_surface(v) || (cut_faces & ~(1u << i)) != 0) continue;
    cut_.work += cost::kNearby;
    if (!cut_.surface().is_within(mesh_.position(v), kCrumb_h * std::min(cut_.h, mesh_.local_h(v))))
      return false;
  }
  return true;
}

// Whether all of a tetrahedron is near the surface.
bool Islands::is_thin(TetId t) const {
  cut_.work += cost::kThin;
  return std::ranges::all_of(mesh_.vertices(t), [this](VertexId v) {
    return cut_.on_surface(v) || cut_.surface().is_within(mesh_.position(v), kThin_local * mesh_.local_h(v));
  });
}

}  // namespace incise::core
