#include "server/core/cut/conforming/flips.hpp"

#include <algorithm>

namespace incise::core {

std::span<const TetId> Flips::improve(TetId t) {
  const auto vertices = mesh_.vertices(t);
  is_needle_ = mesh_.worst_dihedral(t) > tolerance::kSnapFloor;
  for (const auto& edge : kEdgeVertices) {
    const auto made = remove_edge(t, vertices[edge[0]], vertices[edge[1]]);
    if (!made.empty()) return made;
  }
  for (int f = 0; f < 4; ++f) {
    const auto made = remove_face(half_face(t, f));
    if (!made.empty()) return made;
  }
  return {};
}

// Whether an edge or a face, all of whose vertices are on the surface, has to stay: in a needle it may go where its middle is off the surface, for then it
// leads through the tissue from one part of what is swept to another.
bool Flips::has_to_stay(const Vec3& middle) const {
  if (!is_needle_) return true;
  cut_.work += cost::kNearby;
  return cut_.surface().is_within(middle, tolerance::kFlipOff_h * cut_.h);
}

// The ring around the edge is filled with triangles instead, each of which makes a tetrahedron with either end: those
// triangles whose worst tetrahedron is best (Klincsek 1980, "Minimal triangulations of polygonal domains").
std::span<const TetId> Flips::remove_edge(TetId t, VertexId a, VertexId b) {
  if (cut_.on_rim(a) || cut_.on_rim(b)) return {};
  if (cut_.on_surface(a) && cut_.on_surface(b) &&
      has_to_stay(lerp(mesh_.position(a), mesh_.position(b), 0.5)))
    return {};
  mesh_.ring(t, a, b, tets_);
  const std::size_t n = tets_.size();
  cut_.work += static_cast<std::int64_t>(n);
  const bool adds = 2 * (n - 2) > n;
  if (n < 3 || n > kMaxRing || (adds && !cut_.may_add()) || !order_ring(t, a, b)) return {};
  cut_.work += static_cast<std::int64_t>(n * n * (n - 2) / 4);
  if (!triangulate(a, b)) return {};
  added_count_ = 0;
  fill(a, b, 0, n - 1);
  return editor_.replace(tets_, std::span(added_.data(), added_count_));
}

// False where the ring is open, at the boundary, or is of more than one region.
bool Flips::order_ring(TetId t, VertexId a, VertexId b) {
  const std::size_t n = tets_.size();
  before_ = -1;
  for (std::size_t i = 0; i < n; ++i) {
    const TetId r = tets_[i], next = tets_[(i + 1) % n];
    before_ = std::max(before_, mesh_.worst_dihedral(r));
    if (mesh_.region(r) != mesh_.region(t)) return false;
    ring_[i] = kNone;
    for (VertexId v : mesh_.vertices(r)) {
      if (v != a && v != b && mesh_.local_index(next, v) >= 0 &&
          (n > 3 || mesh_.local_index(tets_[(i + 2) % n], v) < 0))
        ring_[i] = v;
    }
    if (ring_[i] == kNone) return false;
  }
  const bool forward = signed_volume(mesh_.position(a), mesh_.position(b), mesh_.position(ring_[0]),
                                     mesh_.position(ring_[1])) > 0;
  if (!forward) std::reverse(ring_.begin(), ring_.begin() + static_cast<std::ptrdiff_t>(n));
  return true;
}

// Finds the best triangles for each part of the ring, from shorter ones; false where all have a worse tetrahedron than there is.
bool Flips::triangulate(VertexId a, VertexId b) {
  const std::size_t n = tets_.size();
  const Vec3 &pa = mesh_.position(a), &pb = mesh_.position(b);
  double worst[kMaxRing][kMaxRing];
  for (std::size_t i = 0; i + 1 < n; ++i) worst[i][i + 1] = -1;
  for (std::size_t span = 2; span < n; ++span) {
    for (std::size_t i = 0; i + span < n; ++i) {
      const std::size_t j = i + span;
      worst[i][j] = before_;
      apex_[i][j] = n;
      const Vec3 &p = mesh_.position(ring_[i]), &r = mesh_.position(ring_[j]);
      for (std::size_t k = i + 1; k < j; ++k) {
        double made = std::max(worst[i][k], worst[k][j]);
        if (made >= worst[i][j]) continue;
        const Vec3& q = mesh_.position(ring_[k]);
        made = std::max({made, worst_dihedral(pa, p, q, r), worst_dihedral(p, q, r, pb)});
        if (made >= worst[i][j]) continue;
        worst[i][j] = made;
        apex_[i][j] = k;
      }
    }
  }
  return apex_[0][n - 1] != n;
}

// Adds the tetrahedra at the best triangles for the ring's part from i to j.
void Flips::fill(VertexId a, VertexId b, std::size_t i, std::size_t j) {
  if (j - i < 2) return;
  const std::size_t k = apex_[i][j];
  added_[added_count_++] = {a, ring_[i], ring_[k], ring_[j]};
  added_[added_count_++] = {ring_[i], ring_[k], ring_[j], b};
  fill(a, b, i, k);
  fill(a, b, k, j);
}

// Two to three.
std::span<const TetId> Flips::remove_face(HalfFace h) {
  const HalfFace o = mesh_.opposite(h);
  if (o == kNone || !cut_.may_add()) return {};
  const auto face = mesh_.face_vertices(h);
  if (cut_.face_on_surface(h) && has_to_stay(mesh_.face_middle(h))) return {};
  const std::array<TetId, 2> two{tet_of(h), tet_of(o)};
  if (mesh_.region(two[0]) != mesh_.region(two[1])) return {};
  const VertexId a = mesh_.vertices(two[0])[face_of(h)], b = mesh_.vertices(two[1])[face_of(o)];
  cut_.work += cost::kTryFlip;
  if (mesh_.find_edge(a, b) != kNone) return {};
  const double before = std::max(mesh_.worst_dihedral(two[0]), mesh_.worst_dihedral(two[1]));
  std::array<std::array<VertexId, 4>, 3> added;
  for (std::size_t i = 0; i < 3; ++i) {
    // Seen from a, the face is clockwise, since it is counter-clockwise from outside its tetrahedron.
    added[i] = {a, b, face[i], face[(i + 1) % 3]};
    if (worst_dihedral(mesh_.position(a), mesh_.position(b), mesh_.position(face[i]),
                       mesh_.position(face[(i + 1) % 3])) >= before)
      return {};
  }
  return editor_.replace(two, added);
}

}  // namespace incise::core
