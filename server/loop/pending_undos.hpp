#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "server/core/session/cut_session.hpp"
#include "server/input/pose_sources.hpp"
#include "server/input/spsc_queue.hpp"
#include "server/loop/journal.hpp"
#include "server/loop/undo_history.hpp"

namespace incise::loop {

// What became of an undo.
enum class UndoEnd {
  kDone,
  kInStroke,    // another blade is in its stroke, or one that it waited for did not end it in time
  kBehind,      // the cut, or the checkpointer, did not catch up in time
  kReset,       // the mesh was reset first
  kBegun,       // a stroke began after it was asked for, and before it was done
  kNoStroke,    // there was none to undo
  kOtherBlade,  // there was none of the blade whose it had to be
  kOtherCut,    // there was one, but other blades have cut since it began
};

struct UndoAnswer {
  UndoEnd end = UndoEnd::kDone;
  // Of kDone the blade whose stroke it was; of kInStroke and kBegun the one that was in the way.
  std::uint32_t source = 0;
  // Names. Of kDone the blades whose cuts were undone, first the one whose stroke it was; of kInStroke, kBegun, kOtherBlade and kOtherCut the blades
  // in the way.
  std::vector<std::string> blades;
  bool was_reset = false;  // of kNoStroke: a reset has taken what there was
};

struct UndoWish {
  std::optional<std::uint32_t> source;      // the asker's blade; nothing: an admin asks
  std::shared_ptr<const std::string> name;  // whose stroke it has to be; null: any
  bool others = false;                      // also where other blades have cut since that stroke began
};

// The undos that were asked for, one after the other: each waits until all that was queued before it is drained and cut and the asker's blade
// has ended its stroke, then for the checkpointer to find the state before the last stroke. Going back there is the loop's. A stroke of another
// blade is not waited for, and what another has cut is not taken back unless that was asked for.
//
// A stroke whose blade has been silent for longer than core::CutConfig::gap_limit_s counts as ended: its next pose begins another one. The loop does not end
// it, for a late pose may belong to it, and what is cut must not depend on when poses come.
//
// Thread: the loop's, except for request(). Owns: the requests.
class PendingUndos {
 public:
  // Gives what the checkpointer has found, if there is something.
  using Take = std::function<std::unique_ptr<Undone>()>;
  using Answered = std::function<void(UndoAnswer)>;

  // Sources and journal must outlive this. `journal` may be null if there is never an offer().
  PendingUndos(const input::PoseSources& input, Journal* journal, std::int64_t patience_ns);

  // Before the first request.
  void offer(Take take) { take_ = std::move(take); }
  // FrameLoop::request_undo(). From one thread, which may be another.
  bool request(UndoWish wish, Answered answered);

  // A source has another owner.
  void note_owner(std::uint32_t source, std::shared_ptr<const std::string> name);
  // A pose was accepted.
  void note_pose(std::uint32_t source, std::int64_t arrival_ns) { posed_ns_[source] = arrival_ns; }
  // A stroke has begun, with the event of this source that was drained last.
  void note_stroke(std::uint32_t source);
  // The mesh is as loaded again: ends all that wait.
  void reset();
  // Goes on with the oldest one. What to go back to once that is there: its undo has been answered. Null: there is nothing to do yet.
  std::unique_ptr<Undone> advance(const core::CutSession& session, std::int64_t now_ns);

 private:
  struct Request {
    UndoWish wish;
    Answered answered;
    std::int64_t until_ns = 0;
    input::PoseSources::Marks asked{};  // what was queued when it was asked for
  };
  // Whether there is one to be done: the oldest, in now_.
  bool next();
  // Of the one in now_; then it is the next one's turn.
  void answer(const UndoAnswer& end);
  // Likewise: this blade is in the way.
  void answer(UndoEnd end, std::uint32_t source);
  // A blade in its stroke, preferably another than the asker's.
  std::optional<std::uint32_t> in_stroke(const core::CutSession& session, std::int64_t now_ns) const;
  // The blade that has begun a stroke with a pose that was queued after the one in now_ was asked for.
  std::optional<std::uint32_t> begun_since() const;
  // Why what was found is not to be done for the one in now_.
  std::optional<UndoAnswer> refusal(const Undone& undone) const;
  // Whether all that was queued before it is drained.
  bool drained_before() const;

  const input::PoseSources& input_;
  Journal* const journal_;
  const std::int64_t patience_ns_;
  Take take_;
  input::SpscQueue<Request> requests_;
  std::optional<Request> now_;  // the one at work
  // What the checkpointer was asked for last: its number, and the strokes begun by then.
  std::uint64_t search_ = 0, search_strokes_ = 0;
  bool searching_ = false;           // it was asked, for the one at work
  std::uint64_t strokes_begun_ = 0;  // whatever was undone
  // Counts each source's events up to the one that began its last stroke.
  input::PoseSources::Marks last_begun_{};
  std::array<std::shared_ptr<const std::string>, core::kMaxSources> names_;  // of the owners
  std::array<std::int64_t, core::kMaxSources> posed_ns_{};  // arrival of the last accepted pose
  bool was_reset_ = false;
};

}  // namespace incise::loop
