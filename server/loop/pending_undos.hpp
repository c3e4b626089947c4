#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>

#include "server/core/session/cut_session.hpp"
#include "server/input/pose_sources.hpp"
#include "server/input/spsc_queue.hpp"
#include "server/loop/journal.hpp"
#include "server/loop/undo_history.hpp"

namespace incise::loop {

// What became of an undo.
enum class UndoEnd {
  kDone,
  kInStroke,    // a blade did not end its stroke in time
  kBehind,      // the cut, or the checkpointer, did not catch up in time
  kReset,       // the mesh was reset first
  kBegun,       // a stroke began after it was asked for, and before it was done
  kNoStroke,    // there was none to undo
  kOtherBlade,  // the last stroke was not of the blade whose it had to be
};

// The undos that were asked for, one after the other: each waits until all that was queued before it is drained and cut and no blade is
// in its stroke, then for the checkpointer to find the state before the last stroke. Going back there is the loop's.
//
// Thread: the loop's, except for request(). Owns: the requests.
class PendingUndos {
 public:
  // Gives what the checkpointer has found, if there is something.
  using Take = std::function<std::unique_ptr<Undone>()>;
  using Answered = std::function<void(UndoEnd)>;

  // Sources and journal must outlive this. `journal` may be null if there is never an offer().
  PendingUndos(const input::PoseSources& input, Journal* journal, std::int64_t patience_ns);

  // Before the first request.
  void offer(Take take) { take_ = std::move(take); }
  // FrameLoop::request_undo(). From one thread, which may be another.
  bool request(std::optional<std::uint32_t> source, Answered answered);

  // A stroke has begun, with the event of this source that was drained last.
  void note_stroke(std::uint32_t source);
  // Goes on with the oldest one. What to go back to once that is there: its undo has been answered. Null: there is nothing to do yet.
  std::unique_ptr<Undone> advance(const core::CutSession& session, std::int64_t now_ns);
  // Ends all that wait.
  void end_all(UndoEnd why);

 private:
  struct Request {
    std::optional<std::uint32_t> source;
    Answered answered;
    std::int64_t until_ns = 0;
    input::PoseSources::Marks asked{};  // what was queued when it was asked for
  };
  // Whether there is one to be done: the oldest, in now_.
  bool next();
  // Of the one in now_; then it is the next one's turn.
  void answer(UndoEnd end);
  // Whether a stroke has begun with a pose that was queued after the one in now_ was asked for.
  bool begun_since() const;
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
};

}  // namespace incise::loop
