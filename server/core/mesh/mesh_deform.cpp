#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include "protocol/vertex_hashes.hpp"
#include "server/core/geometry/quality.hpp"
#include "server/core/mesh/tet_mesh.hpp"

// TetMesh in a body that a simulation deforms.
namespace incise::core {

namespace {

template <class Position>
std::uint64_t combined_hash(std::span<const VertexId> vertices, Position position) {
  return protocol::VertexHashes::combined(
      vertices.size(), [&](std::size_t i) { return vertices[i]; },
      [&](std::size_t i) {
        const Vec3 p = position(i);
        return std::array{p.x, p.y, p.z};
      });
}

}  // namespace

std::uint64_t TetMesh::hash_change(std::span<const VertexId> moved, std::span<const Vec3> to) const {
  return combined_hash(moved, [&](std::size_t i) { return vertices_[moved[i]].position; }) ^
         hash_at(moved, to);
}

std::uint64_t TetMesh::hash_at(std::span<const VertexId> vertices, std::span<const Vec3> places) {
  return combined_hash(vertices, [&](std::size_t i) { return places[i]; });
}

void TetMesh::deform(std::vector<VertexId>& moved, std::vector<Vec3>& positions, std::uint64_t hash_change,
                     Delta& delta) {
  if (rest_.empty()) {
    rest_.reserve(vertices_.capacity());
    for (const Vertex& v : vertices_) rest_.push_back(v.position);
  }
  for (std::size_t i = 0; i < moved.size(); ++i) vertices_[moved[i]].position = positions[i];
  log_.deform(hash_change);

  ChangeLog::clear_mesh(delta);
  std::swap(delta.moved, moved);
  std::swap(delta.moved_positions, positions);
  delta.first_added = vertex_slots();
  delta.pieces.clear();
  delta.cut_faces = 0;
  delta.cut_area = 0;
  delta.state_hash = state_hash();
}

// The rest position of the material at a place in the star of v: with the same barycentric coordinates in the same
// tetrahedron. Of a place a little outside, beyond the tetrahedron that it is least far out of.
Vec3 TetMesh::material_at(VertexId v, const Vec3& position) const {
  Vec3 rest = rest_[v];
  double best = -INFINITY;
  for (const Corner corner : star_scratch_) {
    const auto& tet = tets_[tet_of(corner)].vertices;
    const Vec3 p[4] = {vertices_[tet[0]].position, vertices_[tet[1]].position, vertices_[tet[2]].position,
                       vertices_[tet[3]].position};
    const double whole = signed_volume(p[0], p[1], p[2], p[3]);
    if (!(whole > 0)) continue;
    double weights[4];
    double least = INFINITY;
    for (int i = 0; i < 4; ++i) {
      Vec3 q[4] = {p[0], p[1], p[2], p[3]};
      q[i] = position;
      weights[i] = signed_volume(q[0], q[1], q[2], q[3]) / whole;
      least = std::min(least, weights[i]);
    }
    if (least <= best) continue;
    best = least;
    rest = {};
    for (int i = 0; i < 4; ++i) rest += weights[i] * rest_[tet[static_cast<std::size_t>(i)]];
    if (least >= 0) break;
  }
  return rest;
}

// Where the vertex is at rest once it is at this position. What is linear in each tetrahedron, and another map in the next one, may turn a thin one inside
// out: then it goes a part of that way.
Vec3 TetMesh::rest_at(VertexId v, const Vec3& position) const {
  constexpr double kParts[] = {1, 0.75, 0.5, 0.25};
  star(v, star_scratch_);
  const Vec3 material = material_at(v, position);
  // What lies beyond a tetrahedron that is next to flat may be anywhere.
  constexpr double kFar_h = 100;
  if (!(distance(material, rest_[v]) <= kFar_h * mean_edge_length())) return rest_[v];
  for (const double part : kParts) {
    const Vec3 rest = lerp(rest_[v], material, part);
    if (stays_valid_at_rest(v, position, rest)) return rest;
  }
  return rest_[v];
}

// Of the star in star_scratch_. What is flat where it is now says nothing: it is about to be taken out.
bool TetMesh::stays_valid_at_rest(VertexId v, const Vec3& position, const Vec3& rest) const {
  constexpr double kFlat = 1e-3;
  return std::ranges::all_of(star_scratch_, [&](Corner corner) {
    const TetId t = tet_of(corner);
    Vec3 now[4], then[4];
    for (std::size_t i = 0; i < 4; ++i) {
      const VertexId w = tets_[t].vertices[i];
      now[i] = w == v ? position : vertices_[w].position;
      then[i] = w == v ? rest : rest_[w];
    }
    const double before = volume(t), after = signed_volume(now[0], now[1], now[2], now[3]);
    if (after <= kFlat * before) return true;
    if (!(signed_volume(then[0], then[1], then[2], then[3]) * before >=
          kLeastAtRest * rest_volume(tets_[t].vertices) * after))
      return false;
    return is_fair_at_rest(core::worst_dihedral(then[0], then[1], then[2], then[3]),
                           worst_dihedral_at_rest(tets_[t].vertices),
                           core::worst_dihedral(now[0], now[1], now[2], now[3]));
  });
}

}  // namespace incise::core
