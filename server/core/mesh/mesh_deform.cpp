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
Vec3 TetMesh::rest_at(VertexId v, const Vec3& position) const {
  star(v, star_scratch_);
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

}  // namespace incise::core
