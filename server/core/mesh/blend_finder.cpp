#include "server/core/mesh/blend_finder.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "server/core/mesh/change_log.hpp"
#include "server/core/mesh/tet_mesh.hpp"

namespace incise::core {
namespace {

// A least weight from here on counts as inside.
constexpr double kInside = -1e-12;
// From here on the place is so little outside the star, mostly of a vertex that slid along the boundary, that the search need not go
// on: two thirds of its work would be for these.
constexpr double kAlmostInside = -0.02;
// A vertex goes less than an edge length or two in a step: how many tetrahedra farther than its star the search goes.
constexpr int kMaxRings = 8;

}  // namespace

void BlendFinder::note_vertex(VertexId v, const Vec3& rest) {
  slot_of_[v] = static_cast<std::uint32_t>(slots_.size());
  slots_.push_back({v, kNone, rest});
}

void BlendFinder::note_tet(const TetMesh& mesh, const TetState& before, std::uint32_t record) {
  for (const VertexId v : before.vertices) {
    // A vertex that is not noted by now has not moved.
    if (slot_of_[v] == kNone) note_vertex(v, mesh.rest_position(v));
    Slot& slot = slots_[slot_of_[v]];
    corners_.push_back({record, slot.first});
    slot.first = static_cast<std::uint32_t>(corners_.size() - 1);
  }
}

void BlendFinder::clear() {
  for (const Slot& slot : slots_) slot_of_[slot.vertex] = kNone;
  slots_.clear();
  corners_.clear();
}

std::size_t BlendFinder::take_work() {
  return std::exchange(work_, 0);
}

const Vec3& BlendFinder::rest_of(const TetMesh& mesh, VertexId v) const {
  return slot_of_[v] == kNone ? mesh.rest_position(v) : slots_[slot_of_[v]].rest;
}

Blend BlendFinder::find(const TetMesh& mesh, const ChangeLog& log, VertexId v,
                        std::span<const VertexId> seeds) {
  target_ = mesh.rest_position(v);
  const VertexId near = seeds.front();
  best_ = {v, {near, near, near, near}, {1, 0, 0, 0}};
  best_least_ = -INFINITY;
  expanded_.clear();
  for (const VertexId seed : seeds) {
    if (expand(mesh, log, seed)) return best_;
  }
  for (int ring = 0; ring < kMaxRings && best_least_ < kAlmostInside; ++ring) {
    const double least = best_least_;
    for (const VertexId u : std::array(best_.from)) {
      if (expand(mesh, log, u)) return best_;
    }
    if (!(best_least_ > least)) break;
  }
  return best_;
}

// Looks at the tetrahedra that u had: those that the step has changed, then those that it has not. True where one holds the place.
bool BlendFinder::expand(const TetMesh& mesh, const ChangeLog& log, VertexId u) {
  if (std::find(expanded_.begin(), expanded_.end(), u) != expanded_.end()) return false;
  expanded_.push_back(u);
  if (slot_of_[u] != kNone) {
    for (std::uint32_t c = slots_[slot_of_[u]].first; c != kNone; c = corners_[c].next) {
      if (consider(mesh, log.before(corners_[c].record).vertices)) return true;
    }
  }
  mesh.star(u, star_);
  for (const std::uint32_t corner : star_) {
    const TetId t = tet_of(corner);
    if (!log.touched(t) && consider(mesh, mesh.vertices(t))) return true;
  }
  return false;
}

// With r_k the rest positions of the four, e_k = r_k - r_0 and d the place's way from r_0: d = w_1 e_1 + w_2 e_2 + w_3 e_3, by
// Cramer's rule. A tetrahedron of no volume has no finite weights.
bool BlendFinder::consider(const TetMesh& mesh, const std::array<VertexId, 4>& tet) {
  ++work_;
  const Vec3& r0 = rest_of(mesh, tet[0]);
  const Vec3 e1 = rest_of(mesh, tet[1]) - r0, e2 = rest_of(mesh, tet[2]) - r0,
             e3 = rest_of(mesh, tet[3]) - r0, d = target_ - r0;
  const Vec3 n1 = cross(e2, e3);
  const double whole = dot(e1, n1);
  if (!(std::abs(whole) > 0)) return false;
  const double w1 = dot(d, n1) / whole;
  if (!(w1 > best_least_)) return false;
  const double w2 = dot(d, cross(e3, e1)) / whole;
  if (!(w2 > best_least_)) return false;
  const double w3 = dot(d, cross(e1, e2)) / whole;
  if (!(w3 > best_least_)) return false;
  const double w0 = 1 - w1 - w2 - w3;
  if (!(w0 > best_least_)) return false;
  best_least_ = std::min(std::min(w0, w1), std::min(w2, w3));
  best_.from = tet;
  best_.weights = {w0, w1, w2, w3};
  return best_least_ >= kInside;
}

}  // namespace incise::core
