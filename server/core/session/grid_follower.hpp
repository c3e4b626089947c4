#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "server/core/cut/cut_workspace.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/step_tets.hpp"

namespace incise::core {

// Keeps the boundary grid up to date while the body deforms: boundary tetrahedra with a vertex that has moved far are entered
// again, each once, or a new grid is built while the old one is used, when stale entries have doubled it or the body leaves its
// box.
class GridFollower {
 public:
  GridFollower(const TetMesh& mesh, CutWorkspace& workspace)
      : mesh_(mesh), workspace_(workspace), pass_(workspace), fresh_({}, {}, 1) {}

  // What is about to move, and where all vertices will be then. These must live until commit().
  struct Step {
    const std::vector<VertexId>& moved;
    const std::vector<Vec3>& targets;  // by vertex
    // The tetrahedra at these vertices that lie on the boundary, and any others there: those of the list, or all of the boundary's.
    const std::vector<TetId>& listed;
    StepTets* all = nullptr;
  };
  // Call begin(), then look_at() for all vertices and their new places, ascending, some at a time, between `low` and `high`, then settle().
  void begin() {
    rebuilt_ = workspace_.grid.overgrown() || !workspace_.grid.anchored();
    outside_ = 0;
    leaving_.clear();
    staying_.clear();
  }
  void look_at(std::span<const VertexId> vertices, std::span<const Vec3> targets, const Vec3& low,
               const Vec3& high);
  // The vertex only goes to `target` instead, or stays. Ascending, each once.
  void look_again(VertexId v, const Vec3& instead_of, const Vec3& target, bool stays) {
    outside_ -= workspace_.grid.contains(instead_of) ? 0 : 1;
    outside_ += stays || workspace_.grid.contains(target) ? 0 : 1;
    (stays ? staying_ : leaving_).push_back(v);
  }
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
  void enter_where_left(const Step& step, TetId t, const std::array<VertexId, 4>& vertices);

  const TetMesh& mesh_;
  CutWorkspace& workspace_;
  Phase phase_ = Phase::kReady;
  std::size_t next_ = 0;
  TetPass pass_;
  std::size_t outside_ = 0;        // vertices that go out of the grid
  std::vector<VertexId> leaving_;  // perhaps: far from where the tetrahedra around them were last entered
  std::vector<VertexId> staying_;  // of those: the ones that do not move after all, ascending
  bool any_left_ = false;
  std::vector<std::uint64_t>
      left_;  // a bit for each vertex: whether it leaves its anchor; small, since all corners are looked up
  Vec3 low_, high_;  // a box around the boundary, for a new grid
  std::vector<TetId> all_boundary_;
  bool rebuilt_ = false;
  BoundaryGrid fresh_;
};

}  // namespace incise::core
