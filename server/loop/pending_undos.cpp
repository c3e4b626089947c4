#include "server/loop/pending_undos.hpp"

#include <utility>

#include "server/base/clock.hpp"

namespace incise::loop {
namespace {

constexpr std::size_t kMaxRequests = 128;

bool in_stroke(const core::CutSession& session) {
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source)
    if (session.in_stroke(source)) return true;
  return false;
}

}  // namespace

PendingUndos::PendingUndos(const input::PoseSources& input, Journal* journal, std::int64_t patience_ns)
    : input_(input), journal_(journal), patience_ns_(patience_ns), requests_(kMaxRequests) {}

bool PendingUndos::request(std::optional<std::uint32_t> source, Answered answered) {
  if (!take_) return false;
  return requests_.push({source, std::move(answered), monotonic_ns() + patience_ns_, input_.queued()});
}

void PendingUndos::note_stroke(std::uint32_t source) {
  ++strokes_begun_;
  last_begun_[source] = input_.taken(source);
}

bool PendingUndos::next() {
  if (now_) return true;
  Request next;
  if (!requests_.pop(next)) return false;
  now_ = std::move(next);
  return true;
}

void PendingUndos::answer(UndoEnd end) {
  if (now_->answered) now_->answered(end);
  now_.reset();
  searching_ = false;
}

void PendingUndos::end_all(UndoEnd why) {
  while (next()) answer(why);
}

bool PendingUndos::begun_since() const {
  for (std::size_t source = 0; source < last_begun_.size(); ++source)
    if (last_begun_[source] > now_->asked[source]) return true;
  return false;
}

bool PendingUndos::drained_before() const {
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source)
    if (input_.taken(source) < now_->asked[source]) return false;
  return true;
}

std::unique_ptr<Undone> PendingUndos::advance(const core::CutSession& session, std::int64_t now_ns) {
  if (!next()) return nullptr;
  // Who asked meant an older stroke than this one, which would be the one that is removed.
  if (begun_since()) {
    answer(UndoEnd::kBegun);
    return nullptr;
  }
  const bool stroking = in_stroke(session);
  if (now_ns > now_->until_ns) {
    answer(stroking ? UndoEnd::kInStroke : UndoEnd::kBehind);
    return nullptr;
  }
  if (stroking || session.backlog_batches() > 0 || !drained_before()) return nullptr;
  if (!searching_ || search_strokes_ != strokes_begun_) {
    searching_ = journal_->want_undo(++search_);
    search_strokes_ = strokes_begun_;
    return nullptr;
  }
  auto undone = take_();
  if (!undone || undone->request != search_) return nullptr;  // an older one is from before the last stroke
  if (!undone->session) {
    answer(UndoEnd::kNoStroke);
    return nullptr;
  }
  if (now_->source && *now_->source != undone->before.source) {
    answer(UndoEnd::kOtherBlade);  // it began while this waited
    return nullptr;
  }
  answer(UndoEnd::kDone);
  return undone;
}

}  // namespace incise::loop
