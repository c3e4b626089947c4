#pragma once

#include <array>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "server/core/cut/cut_config.hpp"
#include "server/core/cut/cut_workspace.hpp"
#include "server/core/cut/cutter.hpp"
#include "server/core/cut/swept_follower.hpp"
#include "server/core/mesh/delta.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/carried_fields.hpp"
#include "server/core/session/loaded_body.hpp"
#include "server/core/session/piece_tracker.hpp"
#include "server/core/session/vertex_mover.hpp"
#include "server/core/stroke/affine_motion.hpp"
#include "server/core/stroke/stroke_builder.hpp"

namespace incise::core {

// A mesh and the blades that cut it: poses in, deltas out. The server, `incise cut` and `incise replay` all run this.
//
// A host simulation may deform the body: cuts are then made in the deformed body, and the mesh keeps rest positions.
//
// Determinism: the state after revision n is a function of the mesh, the configuration and the calls to push(),
// end_stroke() and deform() in their order. Budgets and call times decide when work is done, never what is done.
//
// Thread: one, at a time. Owns the mesh.
class CutSession {
 public:
  // `fields`: of that mesh, one row for each vertex or tetrahedron. They are carried along, saved with the session, and change
  // nothing in it. Throws MeshError where no mesh can be built of the data (TetMesh), or where a field is not of that mesh.
  CutSession(const MeshData& mesh, const CutConfig& config, std::span<const Field> fields = {});
  // The same, of the body's copy: O(mesh) as well, but it only copies.
  CutSession(const LoadedBody& body, const CutConfig& config);
  ~CutSession();

  // Gives the blade of one source; the configuration's blade stands for all until then. Between strokes only.
  void set_blade(std::uint32_t source, const Blade& blade);

  // Takes a pose of source 0 ... kMaxSources - 1. Rejected poses change nothing.
  PoseVerdict push(std::uint32_t source, const Pose& pose);
  // Ends the stroke of a source (its button was released, or it vanished). No effect between strokes.
  void end_stroke(std::uint32_t source);

  // Moves vertices in a separate step, after all batches that are complete now (Delta::deformation has its
  // outcome). The mesh stays valid for any positions: see VertexMover.
  void deform(std::shared_ptr<const VertexPositions> positions);

  enum class Progress {
    kIdle,       // no batch waits
    kSpent,      // the budget is spent; work is left
    kCommitted,  // a batch is done, or a part of a long one: `delta` takes the mesh to revision()
  };
  // Works on the oldest batch until it is done or the budget is spent. On kCommitted `delta` is overwritten (its
  // arrays keep their capacity: reuse it); call again for the next batch.
  // `known`: if a deformation is next, what gives way in it, as another session in the same state has found (gave_way()).
  Progress advance(WorkBudget& budget, Delta& delta, const std::vector<GaveWay>* known = nullptr);
  // When no batch waits: loads what the strokes in progress will cut next into the caches. Some 30 us for each; changes nothing.
  void prefetch();

  const TetMesh& mesh() const { return mesh_; }
  // The mesh as it is now, renumbered without gaps in the order of ids, with what a later session has to know of the cuts in it. O(mesh).
  MeshData export_data() const;
  // Where the mesh's boundary is, cut faces included, as of the last operation.
  const BoundaryGrid& boundary() const { return workspace_.grid; }
  // Which piece of the body a living tetrahedron is in (Delta::pieces), as of revision().
  std::uint32_t piece(TetId t) const { return pieces_.piece(t); }
  // All pieces that there are but 0, as a delta names them. O(pieces there have been).
  std::vector<Delta::Piece> pieces() const { return pieces_.named(); }
  // As of revision().
  const CarriedFields& fields() const { return fields_; }
  // Carries none from here on.
  void drop_fields() { fields_ = {}; }
  const CutConfig& config() const { return config_; }
  std::uint64_t revision() const { return revision_; }
  // Batches and deformations that wait, including the current one, and their segments.
  std::size_t backlog_batches() const { return queue_.size(); }
  std::size_t backlog_segments() const { return queue_.segments(); }
  bool in_stroke(std::uint32_t source) const;
  bool deformation_waits() const { return deformations_ > 0; }
  // The next call of advance() moves a deformation's vertices, all at once, and commits it.
  bool moves_next() const { return moves_next_; }
  // What gave way in the last deformation, ascending.
  const std::vector<GaveWay>& gave_way() const { return mover_.gave_way(); }
  // Tetrahedra that deformations have looked at.
  std::uint64_t tets_checked() const { return mover_.checked(); }
  // The batch of the last kCommitted, or its part, and what it did. Its stroke is 0 if it was a deformation. Of a batch that is done in parts, the
  // first one has the motion, and the last one ends the stroke if the batch does.
  const Batch& committed_batch() const { return committed_; }
  const CutCounts& committed_counts() const { return committed_counts_; }
  // Whether nothing of that batch is left to be cut.
  bool committed_whole() const { return parts_ == 0; }
  // What the current batch has done so far.
  CutCounts running_counts() const;

  // Everything that later revisions depend on; no batch may wait. See session_state.hpp.
  void archive(Archive& io);

 private:
  // A step in which the tissue at a blade has gone along with the body.
  struct Followed {
    std::uint64_t number;  // of the deformation, from 1
    AffineMotion motion;
  };
  struct Source {
    StrokeBuilder builder;
    std::unique_ptr<Cutter> cutter;
    std::vector<Followed> followed;  // since the blade was at the first line of the next batch
  };
  void recall(std::span<const std::byte> cut_memory);
  Source& source(std::uint32_t number);
  bool finish(WorkBudget& budget);
  bool measure(WorkBudget& budget);
  Progress advance_deformation(WorkBudget& budget, Delta& delta, const std::vector<GaveWay>* known);
  const Batch& where_tissue_is(const Batch& batch, std::vector<Followed>& followed);
  void begin_moving(const std::vector<GaveWay>* known);
  void find_clinging(bool may_follow);
  void cling(std::uint32_t first, const std::vector<double>& ways_m, bool may_follow);
  bool follows(double way_m) const { return way_m > VertexMover::kSamePlace_h * mesh_.mean_edge_length(); }
  static double way_of(const AffineMotion& motion, std::span<const Vec3> places);
  AffineMotion motion_of_body();
  void lead_free_blades();
  void take_committed();
  void describe(Delta& delta);
  void archive_source(Archive& io, std::uint32_t number);

  TetMesh mesh_;
  CutConfig config_;
  CutWorkspace workspace_;
  PieceTracker pieces_;
  CarriedFields fields_;
  std::uint32_t stroke_counter_ = 0;
  std::array<std::unique_ptr<Source>, kMaxSources> sources_;
  BatchQueue queue_;
  // The stage of the oldest batch: it is cut, its pieces are found, its delta is made, its quality is measured.
  enum class Stage { kWaiting, kCutting, kPieces, kCommitting, kMeasuring };
  Stage stage_ = Stage::kWaiting;
  bool is_whole_ = false;                           // nothing is left of it to be cut
  int parts_ = 0;                                   // of it that are committed
  Delta made_;                                      // while it is being made
  std::size_t next_upserted_ = 0, next_moved_ = 0;  // of what is measured
  TetPass measured_;
  WorstDihedral worst_;
  VertexMover mover_;
  SweptFollower follower_;
  std::size_t deformations_ = 0;  // in the queue
  std::uint64_t deformed_ = 0;    // so many are committed
  bool begun_ = false;            // the oldest one is under way
  bool moves_next_ = false;       // and all is known
  std::uint64_t revision_ = 0;
  Batch committed_;
  CutCounts committed_counts_;
  std::vector<std::uint32_t> star_;
  std::vector<VertexPlace> clinging_;                             // of the deformation under way
  std::array<std::optional<AffineMotion>, kMaxSources> follows_;  // how what is at each blade goes in it
  std::array<std::vector<VertexId>, kMaxSources> at_blade_;       // scratch
  std::vector<Vec3> from_, to_;                                   // scratch
  Batch deformation_, batch_;                                     // scratch
};

}  // namespace incise::core
