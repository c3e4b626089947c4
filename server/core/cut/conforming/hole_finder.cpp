#include "server/core/cut/conforming/hole_finder.hpp"

#include <algorithm>
#include <cmath>

namespace incise::core {

using namespace tolerance;

int HoleFinder::edges_at_boundary(HalfFace h, bool& continues) {
  const auto v = mesh_.face_vertices(h);
  int count = 0;
  for (std::size_t k = 0; k < 3; ++k) count += ends_at_boundary(h, v[k], v[(k + 1) % 3], continues);
  return count;
}

// Whether all edges of a face, or of two that share one, are at the boundary, and an older cut continues it beyond one of them: what that
// cut has left where it ends at another one.
bool HoleFinder::is_hole(HalfFace h) {
  const auto v = mesh_.face_vertices(h);
  const auto was_swept = [this](VertexId w) { return cut_.workspace.vertices[w].surface != 0; };
  if (!std::ranges::all_of(v, was_swept)) return false;
  bool continues = false;
  HalfFace second = kNone;
  for (std::size_t k = 0; k < 3; ++k) {
    if (ends_at_boundary(h, v[k], v[(k + 1) % 3], continues)) continue;
    if (second != kNone) return false;
    second = face_beyond(h, v[k], v[(k + 1) % 3]);
    if (second == kNone) return false;
  }
  if (second == kNone) return continues || lies_at_cut(h);
  return std::ranges::all_of(mesh_.face_vertices(second), was_swept) &&
         edges_at_boundary(second, continues) == 2 && continues;
}

// Whether a face's edge is at the boundary. `continues` becomes true where a cut goes on beyond it.
bool HoleFinder::ends_at_boundary(HalfFace h, VertexId a, VertexId b, bool& continues) {
  mesh_.ring(tet_of(h), a, b, ring_);
  cut_.work += cost::kNearby;
  bool ends = false;
  for (TetId t : {ring_.front(), ring_.back()}) {
    for (int f = 0; f < 4; ++f) {
      const HalfFace other = half_face(t, f);
      if (mesh_.opposite(other) != kNone || mesh_.vertices(t)[f] == a || mesh_.vertices(t)[f] == b) continue;
      ends = true;
      continues = continues || ((mesh_.cut_mask(t) >> f & 1) != 0 && lies_beyond(other, h, a, b));
    }
  }
  return ends;
}

// The face inside the tissue that goes on in the plane of another one beyond their edge, whose ring has just been walked; kNone: there is
// none.
HalfFace HoleFinder::face_beyond(HalfFace h, VertexId a, VertexId b) const {
  for (TetId t : ring_) {
    for (int f = 0; f < 4; ++f) {
      const HalfFace other = half_face(t, f);
      if (mesh_.opposite(other) == kNone || mesh_.vertices(t)[f] == a || mesh_.vertices(t)[f] == b) continue;
      if (other != h && mesh_.opposite(other) != h && lies_beyond(other, h, a, b)) return other;
    }
  }
  return kNone;
}

// Whether a cut beyond one of a face's edges would pass near its middle, between its sides, if it went on in its plane: the face of an element that is
// large beside a corner of two cuts is at a larger angle to both.
bool HoleFinder::lies_at_cut(HalfFace h) {
  const auto v = mesh_.face_vertices(h);
  const Vec3 middle = mesh_.face_middle(h);
  for (std::size_t k = 0; k < 3; ++k) {
    const VertexId a = v[k], b = v[(k + 1) % 3];
    mesh_.ring(tet_of(h), a, b, ring_);
    cut_.work += cost::kNearby;
    for (TetId t : {ring_.front(), ring_.back()}) {
      for (int f = 0; f < 4; ++f) {
        const HalfFace other = half_face(t, f);
        if (!(mesh_.cut_mask(t) >> f & 1) || mesh_.vertices(t)[f] == a || mesh_.vertices(t)[f] == b) continue;
        const Vec3 n = normalized(mesh_.twice_area(other)), p = mesh_.position(a);
        if (std::abs(dot(n, middle - p)) > kOne_h * cut_.h || !is_beyond(other, h, a, b)) continue;
        const double one = dot(n, mesh_.barycentre(tet_of(h)) - p);
        const double two = dot(n, mesh_.barycentre(tet_of(mesh_.opposite(h))) - p);
        if (!cut_.is_beside(one, two)) return true;
      }
    }
  }
  return false;
}

// Whether a face goes on in the plane of another one beyond their edge, and is not folded back over it.
bool HoleFinder::lies_beyond(HalfFace other, HalfFace h, VertexId a, VertexId b) const {
  const Vec3 n = mesh_.twice_area(h), m = mesh_.twice_area(other);
  const double along = dot(n, m);
  if (along * along < kCosAlong * kCosAlong * squared_length(n) * squared_length(m)) return false;
  return is_beyond(other, h, a, b);
}

bool HoleFinder::is_beyond(HalfFace other, HalfFace h, VertexId a, VertexId b) const {
  const Vec3 out = cross(mesh_.position(b) - mesh_.position(a), mesh_.twice_area(h));
  return (dot(out, mesh_.face_middle(h) - mesh_.position(a)) > 0) !=
         (dot(out, mesh_.face_middle(other) - mesh_.position(a)) > 0);
}

}  // namespace incise::core
