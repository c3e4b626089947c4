#include "server/core/cut/conforming/conforming_cutter.hpp"

#include <utility>

#include "server/base/check.hpp"

namespace incise::core {

ConformingCutter::ConformingCutter(TetMesh& mesh, CutWorkspace& workspace, const CutConfig& config)
    : cut_(mesh, workspace, config),
      active_(cut_),
      crossings_(cut_),
      editor_(mesh, cut_, active_),
      joining_(cut_),
      rim_(cut_, editor_),
      search_(cut_, active_, crossings_, rim_, editor_),
      crossing_stage_(cut_, crossings_, editor_),
      repair_(cut_, editor_),
      verify_(cut_, active_, crossings_, editor_),
      opening_(cut_, active_, editor_),
      pinched_(cut_, editor_),
      closing_(cut_, editor_, pinched_) {}

void ConformingCutter::begin_stroke(std::uint32_t stroke) {
  cut_.stroke = stroke;
  cut_.meets_cut = cut_.may_have_failed = false;
  cut_.others.begin_stroke();
  cut_.path.clear();
  active_.clear();
  crossings_.clear();
  rim_.clear();
  joining_.clear();
  closing_.clear();
  pinched_.clear();
}

void ConformingCutter::begin(const Batch& batch) {
  INCISE_CHECK(stage_ == Stage::kIdle);
  begin_part();
  if (batch.stroke != cut_.stroke) begin_stroke(batch.stroke);
  cut_.batch = batch.number;
  cut_.set_front(batch.lines.back(), !batch.ends_stroke);
  const BoundaryGrid& grid = cut_.workspace.grid;
  cut_.path.add(batch, {grid.low(), grid.high(), cut_.mesh.deformed()}, cut_.work);
  cut_.workspace.swept.add(batch.lines, cut_.stroke, cut_.path.travel_before_batch_m(),
                           tolerance::kRemembered_h * cut_.h, cut_.near_tissue());
  joining_.begin(batch);
  stage_ = Stage::kJoining;
}

void ConformingCutter::begin_part() {
  cut_.counts = {};
  cut_.part_judging = 0;
}

// Whether enough has been done for a delta of its own, or would be with as much as this on top.
bool ConformingCutter::end_part(std::size_t more) {
  part_ends_ = cut_.part_is_full(more);
  return part_ends_;
}

void ConformingCutter::begin_search() {
  cut_.path.forget_before(active_.needed_since_m());
  cut_.path.build(cut_.near_tissue());
  cut_.oldest_batch = cut_.path.oldest_batch();
  active_.take_offered();
  editor_.begin_batch();
  repair_.begin_batch();
  crossings_.begin_batch();
  cut_.work += static_cast<std::int64_t>(cut_.surface().triangles().size() / cost::kTrianglesAUnit +
                                         crossings_.size() / cost::kCrossingsAUnit +
                                         active_.size() / cost::kActiveAUnit);
  search_.begin();
  stage_ = Stage::kSearch;
}

ConformingCutter::Progress ConformingCutter::advance(WorkBudget& budget) {
  if (std::exchange(part_ends_, false)) begin_part();
  while (stage_ != Stage::kIdle) {
    cut_.work.charge(budget);
    if (budget.spent()) return Progress::kSpent;
    switch (stage_) {
      case Stage::kJoining:
        if (!joining_.advance(budget)) break;
        begin_search();
        break;
      case Stage::kSearch:
        if (!search_.advance(budget)) break;
        rim_.begin();
        stage_ = Stage::kRim;
        break;
      case Stage::kRim:
        if (!rim_.advance(budget)) break;
        round_ = refinements_ = 0;
        crossing_stage_.begin(round_);
        stage_ = Stage::kCrossings;
        break;
      case Stage::kCrossings:
        if (!crossing_stage_.advance(budget)) break;
        repair_.begin();
        stage_ = Stage::kRepair;
        break;
      case Stage::kRepair:
        if (!repair_.advance(budget)) break;
        verify_.begin(round_ == 0 && refinements_ == 0);
        stage_ = Stage::kVerify;
        break;
      case Stage::kVerify:
        if (!verify_.advance(budget)) break;
        if (verify_.found() && ++round_ < tolerance::kMaxRounds) {
          crossing_stage_.begin(round_);
          stage_ = Stage::kCrossings;
          break;
        }
        verify_.fail_found();
        // In a body that moves, vertices that were put on the surface may be off it by now.
        opening_.begin(cut_.may_add() && !cut_.mesh.deformed() && refinements_ < tolerance::kMaxRefinements);
        stage_ = Stage::kOpening;
        if (end_part()) return Progress::kPart;
        break;
      case Stage::kOpening:
        if (!opening_.advance(budget)) break;
        if (opening_.refined()) {
          ++refinements_;
          round_ = 0;
          verify_.begin(false);
          stage_ = Stage::kVerify;
          break;
        }
        closing_.begin(opening_.opened());
        stage_ = Stage::kClosing;
        break;
      case Stage::kClosing:
        if (closing_.advance(budget)) {
          pinched_.begin();
          stage_ = Stage::kPinched;
        } else if (!closing_.collects() && end_part(closing_.cost_ahead())) {
          return Progress::kPart;
        }
        break;
      case Stage::kPinched:
        if (!pinched_.advance(budget)) break;
        finish();
        break;
      case Stage::kIdle:
        break;
    }
  }
  cut_.work.charge(budget);
  return Progress::kDone;
}

void ConformingCutter::finish() {
  crossings_.drop_done();
  cut_.counts.pending = static_cast<std::uint32_t>(active_.size());
  if (!cut_.has_front) {
    active_.clear_entries();
    cut_.path.clear_surface();
    crossings_.clear();
    rim_.clear();
    closing_.clear();
    pinched_.clear();
  }
  cut_.others.end_batch(active_.size() > 0);
  stage_ = Stage::kIdle;
}

void ConformingCutter::clinging(std::vector<VertexId>& out) const {
  active_.clinging(out);
  crossings_.clinging(out);
  rim_.clinging(out);
}

void ConformingCutter::follow(const AffineMotion& motion) {
  cut_.path.move(motion);
  joining_.move(motion);
  rim_.move(motion);
}

// After the last batch of a stroke all of it is left over and means nothing.
void ConformingCutter::archive(Archive& io) {
  io(cut_.stroke);
  io(cut_.batch);
  io(cut_.meets_cut);
  cut_.path.archive_surface(io);
  active_.archive_entries(io);
  cut_.path.archive_travel(io, active_.widest_m());
  cut_.others.archive(io, active_.size() > 0);
  crossings_.archive(io);
  rim_.archive(io);
  joining_.archive(io);
  closing_.archive(io);
  pinched_.archive(io);
  if (io.reads()) cut_.may_have_failed = true;
}

}  // namespace incise::core
