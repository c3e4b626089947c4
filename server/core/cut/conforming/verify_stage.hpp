#pragma once

#include <cstddef>

#include "server/core/cut/conforming/active_set.hpp"
#include "server/core/cut/conforming/crossings.hpp"
#include "server/core/cut/conforming/mesh_editor.hpp"
#include "server/core/cut/conforming/seen_edges.hpp"

namespace incise::core {

// Looks for crossings that are left: a snap may leave an edge that crosses another part of a bent surface, and so may a repair.
// Looks only at what has changed since the round before.
class VerifyStage {
 public:
  VerifyStage(CutContext& cut, ActiveSet& active, Crossings& crossings, MeshEditor& editor)
      : cut_(cut),
        mesh_(cut.mesh),
        active_(active),
        crossings_(crossings),
        editor_(editor),
        clear_(cut.workspace),
        seen_(cut.workspace) {}

  // `first`: of a batch. Later ones look only at what has changed since, also after chords were split.
  void begin(bool first);
  // True: done; false: the budget is spent.
  bool advance(WorkBudget& budget);
  // Whether there are any.
  bool found() const { return crossings_.size() > first_found_; }
  // Gives up what it has found.
  void fail_found();

 private:
  bool collect_from(TetId t);
  bool collect_from(TetId t, VertexId a, VertexId b);

  CutContext& cut_;
  const TetMesh& mesh_;
  ActiveSet& active_;
  Crossings& crossings_;
  MeshEditor& editor_;
  std::size_t next_ = 0;         // in active_
  std::size_t first_found_ = 0;  // in crossings_
  TetPass clear_;                // tetrahedra without a crossing; MeshEditor takes out what it changes
  SeenEdges seen_;
};

}  // namespace incise::core
