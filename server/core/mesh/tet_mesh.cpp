#include "server/core/mesh/tet_mesh.hpp"

#include <algorithm>
#include <bit>

#include "protocol/state_hash.hpp"
#include "server/base/check.hpp"

// TetMesh: queries, and the ends of a step. Building is in mesh_build.cpp, changes are in mesh_edit.cpp.
namespace incise::core {

namespace {

// By vertex i and face e: the faces that have the vertex, ascending, without e. Where e is i, which does not have it, there are three.
constexpr std::uint8_t kFacesOn[4][4][3] = {{{1, 2, 3}, {2, 3}, {1, 3}, {1, 2}},
                                            {{2, 3}, {0, 2, 3}, {0, 3}, {0, 2}},
                                            {{1, 3}, {0, 3}, {0, 1, 3}, {0, 1}},
                                            {{1, 2}, {0, 2}, {0, 1}, {0, 1, 2}}};

}  // namespace

// The tetrahedra around v that can be reached from `from` through faces that contain v. What is found is fetched while those
// found before it are looked at: in a large mesh waiting for memory is most of this.
void TetMesh::component(VertexId v, TetId from, std::uint32_t mark, std::vector<Corner>& corners) const {
  std::size_t count = 0, room = component_scratch_.size();
  // Until its turn each is there by the face through which it was found, behind which there is nothing new.
  HalfFace* found = component_scratch_.data();
  const Tet* const tets = tets_.data();
  std::uint32_t* const marks = tet_marks_.data();
  const auto look_beyond = [&](HalfFace opposite) {
    if (opposite == kNone || marks[tet_of(opposite)] == mark) return;
    marks[tet_of(opposite)] = mark;
    __builtin_prefetch(&tets[tet_of(opposite)]);
    found[count++] = opposite;
  };
  marks[from] = mark;
  const auto first = static_cast<unsigned>(std::countr_zero(which_are(tets[from].vertices, v)));
  found[count++] = 4 * from + first;
  for (const std::uint8_t f : kFacesOn[first][first]) look_beyond(tets[from].opposite[f]);
  for (std::size_t next = 1; next < count; ++next) {
    if (count + 2 > room) {
      component_scratch_.resize(2 * room);
      room = component_scratch_.size();
      found = component_scratch_.data();
    }
    const HalfFace entered = found[next];
    const Tet& tet = tets[tet_of(entered)];
    const auto i = static_cast<unsigned>(std::countr_zero(which_are(tet.vertices, v)));
    found[next] = (entered & ~3u) + i;
    const auto& faces = kFacesOn[i][face_of(entered)];
    look_beyond(tet.opposite[faces[0]]);
    look_beyond(tet.opposite[faces[1]]);
  }
  corners.insert(corners.end(), found, found + count);
}

void TetMesh::prefetch_around(std::vector<TetId>& tets, std::size_t most) const {
  const std::uint32_t mark = tet_marks_.fresh();
  for (TetId t : tets) tet_marks_[t] = mark;
  for (std::size_t i = 0; i < tets.size(); ++i) {
    const TetId t = tets[i];
    __builtin_prefetch(&cut_masks_[t]);
    log_.prefetch(t);
    for (VertexId v : tets_[t].vertices) {
      prefetch_position(v);
      __builtin_prefetch(&vertex_marks_[v]);
    }
    for (HalfFace h : tets_[t].opposite) {
      if (h == kNone || tet_marks_[tet_of(h)] == mark || tets.size() >= most) continue;
      tet_marks_[tet_of(h)] = mark;
      prefetch(tet_of(h));
      tets.push_back(tet_of(h));
    }
  }
}

void TetMesh::star(VertexId v, std::vector<Corner>& star) const {
  star.clear();
  if (vertices_[v].tet == kNone) return;
  component(v, vertices_[v].tet, tet_marks_.fresh(), star);
}

void TetMesh::ring(TetId from, VertexId a, VertexId b, std::vector<TetId>& ring) const {
  ring.clear();
  // The two vertices of `from` off the edge.
  VertexId off[2];
  int n = 0;
  for (VertexId v : tets_[from].vertices) {
    if (v != a && v != b) off[n++] = v;
  }
  INCISE_CHECK(n == 2, from, a, b);
  // Turns around the edge: leaves through the face opposite to `behind`, so that `ahead` is the next one's behind.
  const auto turn = [&](VertexId behind, VertexId ahead) {
    TetId t = from;
    for (;;) {
      const HalfFace h = tets_[t].opposite[local_index(t, behind)];
      if (h == kNone) return false;
      t = tet_of(h);
      if (t == from) return true;
      ring.push_back(t);
      behind = ahead;
      ahead = tets_[t].vertices[face_of(h)];
    }
  };
  ring.push_back(from);
  if (turn(off[0], off[1])) return;
  std::reverse(ring.begin(), ring.end());
  turn(off[1], off[0]);
}

TetId TetMesh::find_edge(VertexId a, VertexId b) const {
  if (vertices_[a].tet == kNone) return kNone;
  star_scratch_.clear();
  component(a, vertices_[a].tet, tet_marks_.fresh(), star_scratch_);
  for (const Corner corner : star_scratch_) {
    if (local_index(tet_of(corner), b) >= 0) return tet_of(corner);
  }
  return kNone;
}

// ------------------------------------------------------------------------------------------------ the state

std::uint64_t TetMesh::hash_of_vertex(VertexId v) const {
  const Vec3& p = vertices_[v].position;
  return protocol::vertex_hash(v, p.x, p.y, p.z);
}

std::uint64_t TetMesh::hash_of_tet(TetId t) const {
  return protocol::tet_hash(t, tets_[t].vertices.data(), region(t), cut_masks_[t]);
}

std::uint64_t TetMesh::compute_state_hash() const {
  std::uint64_t hash = 0;
  for (VertexId v = 0; v < vertex_slots(); ++v) hash ^= hash_of_vertex(v);
  for (TetId t = 0; t < tet_slots(); ++t) {
    if (alive(t)) hash ^= hash_of_tet(t);
  }
  return hash;
}

void TetMesh::commit(Delta& delta) {
  WorkBudget budget = WorkBudget::unlimited();
  commit(delta, budget);
}

bool TetMesh::commit(Delta& delta, WorkBudget& budget) {
  return log_.commit(*this, delta, budget);
}

}  // namespace incise::core
