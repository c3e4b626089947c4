#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "server/core/cut/cut_workspace.hpp"
#include "server/core/mesh/tet_mesh.hpp"

namespace incise::core {

// Keeps the boundary grid up to date while the body deforms: boundary tetrahedra with a vertex that has moved far are entered
// again, each once, or a new grid is built while the old one is used, when stale entries have doubled it or the body leaves its
// box.
class GridFollower {
 public:
  GridFollower(const TetMesh& mesh, CutWorkspace& workspace)
      : mesh_(mesh), workspace_(workspace), pass_(workspace), fresh_({}, {}, 1) {}

  // With its vertices: a step passes the boundary again, and tetrahedra lie all over memory.
  struct BoundaryTet {
    TetId id;
    std::array<VertexId, 4> vertices;
  };
  // What is about to move, where to, and where all vertices will be then. These must live until commit().
  struct Step {
    const std::vector<VertexId>& moved;
    const std::vector<Vec3>& positions;
    const std::vector<Vec3>& targets;  // by vertex
    // The tetrahedra at these vertices that lie on the boundary, and any others there.
    const std::vector<BoundaryTet>& boundary;
  };
  // Call begin(), then look_at() for each vertex's new place, then settle() for all of them.
  void begin() { rebuilt_ = false; }
  void look_at(const Vec3& target) { rebuilt_ = rebuilt_ || !workspace_.grid.contains(target); }
  void settle(const Step& step);
  // Works until all is ready (true) or the budget is spent (false).
  bool advance(const Step& step, WorkBudget& budget);
  // When the vertices have moved.
  void commit();

 private:
  enum class Phase { kLeave, kFollow, kCollect, kRebuild, kReady };

  bool leave(const Step& step, WorkBudget& budget);
  bool follow(const Step& step, WorkBudget& budget);
  bool collect(const Step& step, WorkBudget& budget);
  bool rebuild(const Step& step, WorkBudget& budget);
  static void enter(BoundaryGrid& grid, const Step& step, TetId t, const std::array<VertexId, 4>& vertices);

  const TetMesh& mesh_;
  CutWorkspace& workspace_;
  Phase phase_ = Phase::kReady;
  std::size_t next_ = 0;
  TetPass pass_;
  std::vector<std::uint32_t> left_;  // by vertex: the step in which it left its anchor
  std::uint32_t serial_ = 0;
  bool any_left_ = false;
  Vec3 low_, high_;  // a box around the boundary, for a new grid
  std::vector<TetId> all_boundary_;
  bool rebuilt_ = false;
  BoundaryGrid fresh_;
};

}  // namespace incise::core
