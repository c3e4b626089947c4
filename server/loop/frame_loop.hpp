#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "server/core/session/cut_session.hpp"
#include "server/haptics/force_stage.hpp"
#include "server/input/pose_sources.hpp"
#include "server/input/positions_slot.hpp"
#include "server/loop/batch_times.hpp"
#include "server/loop/cost_model.hpp"
#include "server/loop/delta_pool.hpp"
#include "server/loop/frame_share.hpp"
#include "server/loop/journal.hpp"
#include "server/loop/loop_stats.hpp"
#include "server/loop/pending_undos.hpp"

namespace incise::loop {

struct LoopOptions {
  double rate_hz = 1000;  // frames a second
  double budget_fraction =
      0.6;  // of a frame, for input and cutting; a deformation may use some of the rest, too
  // Not 0: a frame's cutting is so many work units instead of what fits into its time. For tests: the result
  // must not depend on it.
  std::int64_t units_per_frame = 0;
  // Deltas that the sink's readers may hold at once; with more the cut waits for them.
  std::size_t most_unread_deltas = 1u << 16;
  // How long finish() may cut; what is left then is in the capture, if there is one.
  std::int64_t longest_finish_ns = INT64_MAX;
  // How long an undo waits for the asker's stroke to end, or an admin's for all, and for the cut to catch up.
  std::int64_t undo_patience_ns = 10'000'000'000;
};

// The real-time loop. A frame begins when poses arrive, and one period after the last one where none do. Each frame, in this order: drains the queued poses, checks and batches them, updates the
// forces, cuts until the budget is spent, publishes the deltas of finished batches, accounts. What does not fit is carried
// over to the next frame; poses stay in their queues until the loop gets to them, and none is dropped.
//
// A frame takes no lock, throws nothing and logs nothing, and once buffers are warm it allocates nothing.
//
// Thread: one runs frames; stats() is for any. Owns only its buffers: session, sources, sink and
// journal must outlive it.
class FrameLoop {
 public:
  // `journal` may be null.
  FrameLoop(core::CutSession& session, input::PoseSources& input, DeltaSink& sink, Journal* journal,
            const LoopOptions& options);

  // Makes resets possible; before the first frame. `restart` gives a session as it was loaded, or null where there is none yet:
  // it is asked again in the next frame. `done` informs the other parts before the first pose, gets the session that was replaced (null:
  // the one that the loop was made with), and returns the new session's id. Both run on the loop's thread, in a frame.
  using Restart = std::function<std::unique_ptr<core::CutSession>()>;
  using ResetDone = std::function<std::uint64_t(std::unique_ptr<core::CutSession> used)>;
  void offer_reset(Restart restart, ResetDone done);
  // Asks for one, at the start of a frame soon: revision 0, strokes gone, blades with their owners as before. False
  // where it was not offered. From any thread.
  bool request_reset();

  // Makes it possible to undo strokes; before the first frame, and only with a journal that has a checkpointer, which is asked for the
  // state before a stroke. `take` gives what that has found, if there is something; `done` is as for resets. Both run on the loop's thread.
  using TakeUndone = PendingUndos::Take;
  using UndoDone = ResetDone;
  void offer_undo(TakeUndone take, UndoDone done);
  // Asks for it: all is as it was before the last stroke that cut something began, at a new session id; with a name in `wish` the last one of the blade of that
  // name, if no other has cut since it began or `wish.others`. Done between strokes: it waits while the asker's blade cuts, or without a source
  // while any does, but not beyond LoopOptions::undo_patience_ns, and is given up at once where another one does. It is for the strokes whose first pose was
  // queued before this call: where another one begins before it is done, it is given up. Several that are asked for are done one
  // after the other. `answered`, which may be empty, is called once, on the loop's thread and before `done`; never where the loop ends first. False where
  // it was not offered, or too many wait. From one thread.
  using UndoAnswered = PendingUndos::Answered;
  bool request_undo(UndoWish wish, UndoAnswered answered);

  // Makes forces, in each frame between drain and cut; before the first frame. `tissue` knows of all
  // cuts so far. `sink`, `slots` and `link` may be null; otherwise they must outlive this.
  void offer_forces(const haptics::ForceConfig& config, std::unique_ptr<haptics::Tissue> tissue,
                    haptics::ForceSink* sink, haptics::ForceSlots* slots,
                    haptics::SimulationLink* link = nullptr);

  // Deforms the body to a host simulation's newest positions, in each frame after drain, once the last ones are done. Call
  // before the first frame; `positions` must outlive this.
  void offer_deformation(input::PositionsSlot& positions) { positions_ = &positions; }

  // Frames until a stop is asked for; then finish(). Without poses they keep to deadlines (absolute, so they do not drift), and one
  // that could not begin before the next one's time is skipped and counted: late work does not pile up as frames. With poses
  // they follow their arrival, at most ten in a millisecond, whatever the rate and phase of the sources.
  void run(const std::stop_token& stop) noexcept;
  // One frame that should have begun at `deadline_ns` (CLOCK_MONOTONIC).
  void frame(std::int64_t deadline_ns) noexcept;
  // Closes the sources, drains their queues, ends all strokes, cuts and publishes everything.
  void finish() noexcept;

  const LoopStats& stats() const { return stats_; }

 private:
  void handle(std::uint32_t source, const input::InputEvent& event, std::int64_t now_ns);
  void drain(std::int64_t now_ns, std::int64_t until_ns);
  std::int64_t feel(std::int64_t now_ns, std::int64_t late_ns);
  void cut(std::int64_t cuts_until_ns, std::int64_t steps_until_ns, std::int64_t latest_ns);
  bool wait(std::int64_t deadline_ns) noexcept;
  void commit(PublishedDelta& out, std::int64_t now_ns);
  void publish();
  void account(std::int64_t deadline_ns, std::int64_t start_ns, std::int64_t drained_ns, std::int64_t felt_ns,
               std::int64_t cut_ns, std::int64_t end_ns);
  void start_deformation(std::int64_t now_ns);
  // Whether the journal has it.
  bool write(const JournalRecord& record);
  void reset();
  void go_back(Undone undone);
  // What the session's body has been cut before. O(mesh) where it has been.
  void count_first_cuts();
  // Goes on with another session. `done` gives its id.
  void replace(std::unique_ptr<core::CutSession> other, const LoopState& state, const BladesSums& blades,
               JournalRecord record, const ResetDone& done);

  core::CutSession* session_;
  std::unique_ptr<core::CutSession> own_session_;  // since the last reset
  Restart restart_;
  ResetDone reset_done_;
  std::atomic<bool> reset_wanted_{false};
  PendingUndos undos_;
  UndoDone undo_done_;
  std::vector<core::HalfFace> cuts_to_note_;
  std::int64_t last_start_ns_ = 0;                                    // of the frame before
  std::unique_ptr<haptics::ForceStage> forces_;                       // null: none are made
  std::array<std::optional<core::Blade>, core::kMaxSources> blades_;  // of the sources that were opened
  std::array<std::uint32_t, core::kMaxSources> owners_{};             // the numbers of their owners
  std::array<std::shared_ptr<const std::string>, core::kMaxSources> names_;  // and their names
  input::PoseSources& input_;
  input::PositionsSlot* positions_ = nullptr;
  std::shared_ptr<const core::VertexPositions> deforming_;  // while a step is under way
  std::int64_t step_ns_ = 0;                                // that moving the last one's vertices took
  DeltaSink& sink_;
  Journal* const journal_;
  const LoopOptions options_;
  const std::int64_t period_ns_;
  // Of a frame, for input and cutting, and for these and a body's deformation.
  FrameShare for_cuts_, for_steps_;

  CostModel cost_;
  double ns_per_segment_ = 20'000;  // of whole batches, measured: for the estimate of the backlog
  DeltaPool pool_;
  std::vector<std::shared_ptr<const PublishedDelta>> ready_;  // committed in this frame
  std::int64_t batch_work_ns_ = 0, delta_work_ns_ = 0;  // on the batch at work, so far; since its last part
  BatchTimesQueue times_;                               // of all that session_ has in its queue
  LoopState state_;
  // Of the body that the session began with: a session that goes on, with the cuts of before.
  std::uint64_t first_cut_faces_ = 0;
  double first_cut_area_m2_ = 0;
  BladesNow blades_now_{};
  bool blades_moved_ = false;  // in this frame
  LoopStats stats_;
};

}  // namespace incise::loop
