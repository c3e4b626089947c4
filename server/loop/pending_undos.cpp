#include "server/loop/pending_undos.hpp"

#include <bit>
#include <utility>

#include "server/base/clock.hpp"

namespace incise::loop {
namespace {

constexpr std::size_t kMaxRequests = 128;

// A blade in its stroke, preferably another than `own`.
std::optional<std::uint32_t> in_stroke(const core::CutSession& session, std::optional<std::uint32_t> own) {
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source)
    if (source != own && session.in_stroke(source)) return source;
  return own && session.in_stroke(*own) ? own : std::nullopt;
}

}  // namespace

PendingUndos::PendingUndos(const input::PoseSources& input, Journal* journal, std::int64_t patience_ns)
    : input_(input), journal_(journal), patience_ns_(patience_ns), requests_(kMaxRequests) {}

bool PendingUndos::request(UndoWish wish, Answered answered) {
  if (!take_) return false;
  return requests_.push({wish, std::move(answered), monotonic_ns() + patience_ns_, input_.queued()});
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

void PendingUndos::answer(UndoEnd end, std::uint32_t blade) {
  if (now_->answered) now_->answered({end, blade});
  now_.reset();
  searching_ = false;
}

void PendingUndos::end_all(UndoEnd why) {
  while (next()) answer(why);
}

std::optional<std::uint32_t> PendingUndos::begun_since() const {
  for (std::uint32_t source = 0; source < last_begun_.size(); ++source)
    if (last_begun_[source] > now_->asked[source]) return source;
  return std::nullopt;
}

bool PendingUndos::drained_before() const {
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source)
    if (input_.taken(source) < now_->asked[source]) return false;
  return true;
}

std::optional<UndoAnswer> PendingUndos::refusal(const Undone& undone) const {
  if (!undone.session) return UndoAnswer{UndoEnd::kNoStroke, 0};
  if (!now_->wish.source) return std::nullopt;
  if (*now_->wish.source != undone.before.source)
    return UndoAnswer{UndoEnd::kOtherBlade, undone.before.source};
  const std::uint32_t others = undone.cut_since & ~(1u << undone.before.source);
  if (others == 0 || now_->wish.others) return std::nullopt;
  return UndoAnswer{UndoEnd::kOtherCut, static_cast<std::uint32_t>(std::countr_zero(others))};
}

std::unique_ptr<Undone> PendingUndos::advance(const core::CutSession& session, std::int64_t now_ns) {
  if (!next()) return nullptr;
  // Who asked meant an older stroke than this one, which would be the one that is removed.
  if (const auto blade = begun_since()) {
    answer(UndoEnd::kBegun, *blade);
    return nullptr;
  }
  const bool late = now_ns > now_->until_ns;
  if (!drained_before()) {
    if (late) answer(UndoEnd::kBehind);
    return nullptr;
  }
  if (const auto blade = in_stroke(session, now_->wish.source)) {
    // An operator does not wait for another one; an admin finds them between two strokes.
    const bool of_another = now_->wish.source && blade != now_->wish.source;
    if (late || of_another) answer(UndoEnd::kInStroke, *blade);
    return nullptr;
  }
  if (late) {
    answer(UndoEnd::kBehind);
    return nullptr;
  }
  if (session.backlog_batches() > 0) return nullptr;
  if (!searching_ || search_strokes_ != strokes_begun_) {
    searching_ = journal_->want_undo(++search_);
    search_strokes_ = strokes_begun_;
    return nullptr;
  }
  auto undone = take_();
  if (!undone || undone->request != search_) return nullptr;  // an older one is from before the last stroke
  if (const auto why_not = refusal(*undone)) {
    answer(why_not->end, why_not->blade);
    return nullptr;
  }
  answer(UndoEnd::kDone, undone->before.source);
  return undone;
}

}  // namespace incise::loop
