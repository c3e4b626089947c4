#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/geometry/vec3.hpp"
#include "server/core/mesh/delta.hpp"
#include "server/core/util/room.hpp"

namespace incise::core {

class ChangeLog;
class TetMesh;

// Finds which material a vertex stands for after a step, in the mesh as it was before: the tetrahedron that held its rest
// position. The search begins in stars and goes on through stars, so it stays on the vertex's side of older cuts. Of a place
// outside (a vertex slides along a curved boundary), or hardly outside the star, the weights of the tetrahedron that it is least far out of
// go on linearly.
//
// A ChangeLog notes here what a step changes: before that, a vertex; when the step is done, the tetrahedra as they were. What
// is not noted is as it was. The cost is that of what is noted and of the stars that are searched, mostly one for each vertex.
class BlendFinder {
 public:
  void reserve(std::size_t vertices) { reserve_room(slot_of_, vertices); }
  // Room for vertices below this.
  void grow(VertexId vertex_slots) { slot_of_.resize(vertex_slots, kNone); }
  // A vertex that existed before the step, as it was then. Once for each.
  void note_vertex(VertexId v, const Vec3& rest);
  // The tetrahedron that the log has as `record`, with the vertices that it had.
  void note_tet(const TetMesh& mesh, const TetState& before, std::uint32_t record);
  // Where a noted vertex was at rest.
  const Vec3& rest_before(VertexId v) const { return slots_[slot_of_[v]].rest; }
  // `seeds`: vertices of that time, near the place.
  Blend find(const TetMesh& mesh, const ChangeLog& log, VertexId v, std::span<const VertexId> seeds);
  // How many tetrahedra find() has looked at since the last call.
  std::size_t take_work();
  // Forgets what was noted.
  void clear();

 private:
  struct Slot {
    VertexId vertex;
    std::uint32_t first;  // into corners_
    Vec3 rest;
  };
  struct Corner {
    std::uint32_t record, next;
  };
  bool expand(const TetMesh& mesh, const ChangeLog& log, VertexId u);
  bool consider(const TetMesh& mesh, const std::array<VertexId, 4>& tet);
  const Vec3& rest_of(const TetMesh& mesh, VertexId v) const;

  std::vector<std::uint32_t> slot_of_;  // by vertex
  std::vector<Slot> slots_;
  std::vector<Corner> corners_;
  std::size_t work_ = 0;

  // Of one search.
  Vec3 target_;
  Blend best_;
  double best_least_ = 0;  // its least weight
  std::vector<VertexId> expanded_;
  std::vector<std::uint32_t> star_;
};

}  // namespace incise::core
