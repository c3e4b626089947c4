#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/cut/conforming/bridge_finder.hpp"
#include "server/core/cut/conforming/bridge_suspects.hpp"
#include "server/core/cut/conforming/cut_context.hpp"
#include "server/core/cut/conforming/gap_finder.hpp"
#include "server/core/cut/conforming/mesh_editor.hpp"
#include "server/core/cut/conforming/neck.hpp"
#include "server/core/cut/conforming/parts.hpp"
#include "server/core/cut/conforming/pinched_edges.hpp"
#include "server/core/cut/conforming/two_sides.hpp"

namespace incise::core {

// Closes the gaps between what has just opened and what was open before: an older cut, an earlier part of this one, the body's
// boundary. A face near the surface all of whose vertices lie there may be all that still holds two parts together. It opens where
// its two sides hang together in no other way near by.
class ClosingStage {
 public:
  ClosingStage(CutContext& cut, MeshEditor& editor, PinchedEdges& pinched)
      : cut_(cut),
        mesh_(cut.mesh),
        editor_(editor),
        pinched_(pinched),
        pass_(cut.workspace),
        parts_(cut),
        sides_(cut),
        grid_(cut),
        neck_(cut, grid_),
        suspects_(cut),
        bridges_(cut, grid_),
        finder_(cut) {}

  void clear() {
    waiting_.clear();
    suspects_.clear();
  }
  // `opened`: the faces that this batch has opened, both sides of each.
  void begin(std::span<const HalfFace> opened);
  // True: done; false: the budget is spent, a part of the batch is full, or more is to do.
  bool advance(WorkBudget& budget);

  // While faces are collected, or a bridge is looked for, nothing but the budget makes it stop, and no part of a batch ends.
  bool collects() const {
    if (phase_ == Phase::kFindBridges) return bridges_.is_looking() && cost_ahead() == 0;
    return phase_ != Phase::kJudge && phase_ != Phase::kLookFar && phase_ != Phase::kOpen;
  }
  // What comes next would cost so much at once, for a part of the batch.
  std::size_t cost_ahead() const { return phase_ == Phase::kFindBridges ? bridges_.cost_ahead() : 0; }
  void archive(Archive& io);

 private:
  enum class Phase {
    kCollect,
    kCollectMade,
    kCollectWaiting,
    kCollectHeld,
    kCollectAroundHeld,
    kJudge,
    kLookFar,
    kOpen,
    kCollectRibs,
    kCollectNecks,
    kFindBridges
  };
  using Part = Parts::Part;
  using Kind = Gap::Kind;
  // A face near the blade. While this has travelled less in the stroke, its sides may hang together before the blade.
  struct Waiting {
    HalfFace face;
    double ripe_at_m;
  };

  void go(Phase phase) {
    phase_ = phase;
    next_ = 0;
  }
  void begin_around();
  void list_around(HalfFace h);
  bool collect(WorkBudget& budget);
  bool collect_made(WorkBudget& budget);
  bool collect_waiting(WorkBudget& budget);
  bool collect_held(HeldFaces& held, Kind kind, WorkBudget& budget);
  bool judge(WorkBudget& budget);
  bool look_far(WorkBudget& budget);
  bool open(WorkBudget& budget);
  void open(std::span<const HalfFace> faces);
  bool goes_on(WorkBudget& budget);
  void consider_faces(TetId t);
  void consider_new_faces(TetId t);
  void consider(HalfFace h);
  bool has_to_wait(HalfFace h);
  // One of the two sides of a face waits for both.
  bool waits(HalfFace h) const { return is_marked(h) || is_marked(mesh_.opposite(h)); }
  bool is_marked(HalfFace h) const {
    const CutWorkspace::TetMarks& marks = cut_.workspace.tets[tet_of(h)];
    return marks.waits_for == cut_.stroke && (marks.waiting >> face_of(h) & 1) != 0;
  }
  void set_waits(HalfFace h, bool waits) {
    CutWorkspace::TetMarks& marks = cut_.workspace.tets[tet_of(h)];
    // Another blade may have to list its own faces again.
    if (marks.waits_for != cut_.stroke) marks.waiting = 0;
    marks.waits_for = cut_.stroke;
    const auto bit = static_cast<std::uint8_t>(1u << face_of(h));
    marks.waiting = static_cast<std::uint8_t>(waits ? marks.waiting | bit : marks.waiting & ~bit);
  }
  bool all_at_boundary(HalfFace h) const;
  static bool is_part(Part part) { return part == Part::kSmall || part == Part::kLarge; }
  void hold(const Gap& gap);
  void keep_closed(const Gap& gap);
  bool stays_closed(const Gap& gap);
  bool stays_closed(const Gap& gap, HalfFace h, std::span<const TetId> part);
  bool may_lead_through(const Gap& gap);
  void keep_rest_closed();
  bool find_bridges(WorkBudget& budget);
  bool next_suspect(WorkBudget& budget);
  bool parts_something(std::span<const HalfFace> faces);
  void list_pinched(HalfFace opened);

  CutContext& cut_;
  const TetMesh& mesh_;
  MeshEditor& editor_;
  PinchedEdges& pinched_;

  Phase phase_ = Phase::kCollect;
  Kind round_ = Kind::kAcross;  // when the stroke ends: without ribs, with these, then the necks
  std::size_t next_ = 0;        // how far the phase is, in its list
  // Of the faces that this batch has opened, both sides; then of those held; then of those opened here.
  std::vector<VertexId> around_;
  std::uint32_t scan_ = 0;  // marks what is in around_
  std::vector<Waiting> waiting_;
  std::vector<Gap> gaps_;
  // In the round of the necks: what is judged only where one of these opens, or where something small between two parts stays with one of them: it may hang
  // by some of these with the other.
  std::vector<Gap> rest_;
  bool hangs_between_ = false;
  std::vector<HeldFace> left_;   // for a stroke that comes upon a cut, or for another blade
  std::vector<HalfFace> faces_;  // to open
  std::vector<Gap> doubtful_;    // between two large parts, when the stroke ends
  TetPass pass_;                 // whose faces have been considered
  Parts parts_;
  TwoSides sides_;
  TissueGrid grid_;
  Neck neck_;
  BridgeSuspects suspects_;
  BridgeFinder bridges_;
  GapFinder finder_;
  std::size_t asked_ = 0;  // how many faces Neck was asked about in this batch
  // The largest tetrahedron of a part that is apart, as Neck says, and how many that part has.
  TetId apart_ = kNone;
  std::size_t apart_size_ = 0;
  std::vector<HalfFace> together_;  // faces whose sides hang together, as it says
  std::vector<Waiting> waited_;     // those that this batch looks at
  std::vector<HalfFace> others_;    // scratch
  std::vector<Corner> star_;        // scratch
};

}  // namespace incise::core
