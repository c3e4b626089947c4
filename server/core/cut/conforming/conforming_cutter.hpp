#pragma once

#include <vector>

#include "server/core/cut/conforming/active_set.hpp"
#include "server/core/cut/conforming/closing_stage.hpp"
#include "server/core/cut/conforming/crossing_stage.hpp"
#include "server/core/cut/conforming/crossings.hpp"
#include "server/core/cut/conforming/cut_context.hpp"
#include "server/core/cut/conforming/joining_stage.hpp"
#include "server/core/cut/conforming/mesh_editor.hpp"
#include "server/core/cut/conforming/opening_stage.hpp"
#include "server/core/cut/conforming/pinched_edges.hpp"
#include "server/core/cut/conforming/repair_stage.hpp"
#include "server/core/cut/conforming/rim_stage.hpp"
#include "server/core/cut/conforming/search_stage.hpp"
#include "server/core/cut/conforming/verify_stage.hpp"
#include "server/core/cut/cutter.hpp"

namespace incise::core {

// The policy `conforming`, for one blade. Each batch goes through these stages:
//
//   joining     a first or last line, or the way of heel or tip, near an older cut or the boundary is continued through it.
//   search      which tetrahedra the new swept triangles meet. They join the active ones.
//   rim         where the sweep's rim pierces a face, a vertex is put on the rim.
//   crossings   where the surface crosses an edge of an active tetrahedron, a vertex is put on the surface: the nearer
//               end of the edge is snapped there, else the farther end, else the edge is split. A tetrahedron that
//               thereby gets all four vertices on the surface is flat and is removed.
//   repair      poor tetrahedra that this has left are improved.
//   verify      crossings that snaps and repairs have made: back to `crossings`, twice at most.
//   opening     a face opens exactly when the line between the reference points of its two tetrahedra crosses the
//               surface; each vertex gets one copy for each component of its star.
//   closing     where that comes upon an older cut or the boundary, faces that would still hold the two sides together open.
//   pinched     an edge around which the tissue hangs together in two fans gets a vertex in one of them.
//
// All but the search keep one element behind the blade: a tetrahedron with a vertex near the blade's present line
// waits, for what is swept next may cross it too. So the result hardly depends on how finely the motion is sampled.
// At the stroke's end nothing waits any more.
//
// A batch that takes long is done in parts, which end before the opening and in the closing, so that what is open is seen.
//
// Each operation leaves a valid mesh, and the budget is looked at after each. A stage keeps how far it is in its own members:
// begin() resets them, advance() goes on.
class ConformingCutter final : public Cutter {
 public:
  // Both must outlive this; the workspace is shared by all blades of the mesh.
  ConformingCutter(TetMesh& mesh, CutWorkspace& workspace, const CutConfig& config);

  void begin(const Batch& batch) override;
  Progress advance(WorkBudget& budget) override;
  const CutCounts& counts() const override { return cut_.counts; }
  void clinging(std::vector<VertexId>& out) const override;
  void follow(const AffineMotion& motion) override;
  void prefetch() override { active_.prefetch(); }

  BatchNumber last() const override { return {cut_.stroke, cut_.batch}; }
  void archive(Archive& io) override;

 private:
  enum class Stage {
    kIdle,
    kJoining,
    kSearch,
    kRim,
    kCrossings,
    kRepair,
    kVerify,
    kOpening,
    kClosing,
    kPinched
  };

  void begin_stroke(std::uint32_t stroke);
  void begin_part();
  bool end_part(std::size_t more = 0);
  void begin_search();
  void finish();

  CutContext cut_;
  ActiveSet active_;
  Crossings crossings_;
  MeshEditor editor_;

  JoiningStage joining_;
  RimStage rim_;
  SearchStage search_;
  CrossingStage crossing_stage_;
  RepairStage repair_;
  VerifyStage verify_;
  OpeningStage opening_;
  PinchedEdges pinched_;
  ClosingStage closing_;

  Stage stage_ = Stage::kIdle;
  int round_ = 0;        // of crossings, repair and verification
  int refinements_ = 0;  // of chords, in this batch
  bool part_ends_ = false;
};

}  // namespace incise::core
