#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "server/core/cut/conforming/flips.hpp"
#include "server/core/cut/conforming/mesh_editor.hpp"
#include "server/core/cut/conforming/placement.hpp"

namespace incise::core {

// Improves what is poor around the vertices that this batch has put on the surface or made.
class RepairStage {
 public:
  RepairStage(CutContext& cut, MeshEditor& editor)
      : cut_(cut), mesh_(cut.mesh), editor_(editor), places_(cut), flips_(cut, editor) {}

  // A new batch: nothing has changed.
  void begin_batch() {
    editor_.changed().clear();
    next_changed_ = 0;
  }
  void begin() {
    repairing_ = false;
    serial_ = cut_.workspace.next_serial();
  }
  // True: done; false: the budget is spent.
  bool advance(WorkBudget& budget);

 private:
  void take_next();
  void end_vertex();
  void improve();
  void try_moving(VertexId v);
  bool try_flips(TetId t);
  void try_collapses(TetId t);
  void note_poor(TetId t);
  bool is_poor(TetId t, double limit = tolerance::kGood) const;
  bool is_film(TetId t) const;
  void merge_near(VertexId v);
  bool is_free_to_go(VertexId v, VertexId w) const;
  bool may_merge(VertexId v, VertexId w) const;
  bool try_collapse(const VertexStar& star, TetId t, VertexId v, VertexId w);
  bool crosses_after(const VertexStar& star, VertexId v, VertexId w) const;

  CutContext& cut_;
  const TetMesh& mesh_;
  MeshEditor& editor_;
  PlaceFinder places_;
  Flips flips_;

  std::size_t next_changed_ = 0;  // in MeshEditor::changed()
  std::uint32_t serial_ = 0;      // of these repairs
  // The vertex that is repaired, and its poor tetrahedra, of which one is at work: moving one of its vertices (0 to 3),
  // flips (4), collapses (5).
  bool repairing_ = false;
  MeshEditor::Changed repaired_{};
  std::vector<TetId> poor_;
  std::size_t next_poor_ = 0;
  int remedy_ = 0;

  VertexStar star_, other_star_;
  std::vector<Corner> corners_;  // around the vertex that may_merge() asks about
};

}  // namespace incise::core
