#pragma once

#include <cstddef>
#include <vector>

#include "server/core/cut/conforming/active_set.hpp"
#include "server/core/cut/conforming/crossings.hpp"
#include "server/core/cut/conforming/rim_stage.hpp"
#include "server/core/geometry/four_points.hpp"

namespace incise::core {

// Finds the tetrahedra that the new swept triangles meet: from the ones met before and from the boundary inwards, then by
// adjacency. They become active; crossings of their edges and of their faces with the rim are noted.
class SearchStage {
 public:
  SearchStage(CutContext& cut, ActiveSet& active, Crossings& crossings, RimStage& rim, MeshEditor& editor)
      : cut_(cut),
        mesh_(cut.mesh),
        active_(active),
        crossings_(crossings),
        rim_(rim),
        editor_(editor),
        searched_(cut.workspace) {}

  void begin();
  // True: done; false: the budget is spent, or more is to do.
  bool advance(WorkBudget& budget);

 private:
  // Where the search begins, in this order; then it spreads, and last the rest of the rim is looked at.
  enum class Phase { kActive, kLines, kBoundary, kInside, kSpread, kRim };

  void go(Phase phase, std::size_t first) {
    phase_ = phase;
    next_ = first;
  }
  bool work_left(WorkBudget& budget) {
    cut_.work.charge(budget);
    return !budget.spent();
  }
  void from_active(WorkBudget& budget);
  void from_lines(WorkBudget& budget);
  void from_boundary(WorkBudget& budget);
  void from_inside();
  void spread(WorkBudget& budget);
  bool end_of_rim(WorkBudget& budget);
  void enqueue(TetId t);
  bool probe(TetId t);
  enum class Meets { kNo, kYes, kUnsure };
  const SweptTriangle* find_plane() const;
  Meets probe_plane(TetId t, const FourPoints& p, double slack_m);
  bool find_inside(TetId t, VertexId a, VertexId b);
  struct Beside;
  void probe_rims(TetId t, const SweptTriangle& triangle, const Beside& at);
  void note_standing(TetId t, const SweptTriangle& triangle, const Beside& at, double reach_m);
  bool probe_triangle(TetId t, const FourPoints& p, double slack_m, std::uint32_t index);

  CutContext& cut_;
  const TetMesh& mesh_;
  ActiveSet& active_;
  Crossings& crossings_;
  RimStage& rim_;
  MeshEditor& editor_;

  // Where what was swept last is flat and has no rim: a triangle in whose plane it lies.
  const SweptTriangle* plane_ = nullptr;
  Phase phase_ = Phase::kActive;
  std::size_t next_ = 0;  // how far the phase is, in its list
  TetPass searched_;
  std::vector<TetId> queue_;  // of what meets the sweep
  std::size_t queue_next_ = 0;
  std::vector<TetId> candidates_;  // near a new triangle
  std::size_t next_candidate_ = 0;
};

}  // namespace incise::core
