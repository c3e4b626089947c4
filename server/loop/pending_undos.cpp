#include "server/loop/pending_undos.hpp"

#include <utility>

#include "server/base/clock.hpp"

namespace incise::loop {
namespace {

constexpr std::size_t kMaxRequests = 128;

}  // namespace

PendingUndos::PendingUndos(const input::PoseSources& input, Journal* journal, std::int64_t patience_ns)
    : input_(input), journal_(journal), patience_ns_(patience_ns), requests_(kMaxRequests) {}

bool PendingUndos::request(UndoWish wish, Answered answered) {
  if (!take_) return false;
  return requests_.push(
      {std::move(wish), std::move(answered), monotonic_ns() + patience_ns_, input_.queued()});
}

void PendingUndos::note_owner(std::uint32_t source, std::shared_ptr<const std::string> name) {
  names_[source] = std::move(name);
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

void PendingUndos::answer(const UndoAnswer& end) {
  if (now_->answered) now_->answered(end);
  now_.reset();
  searching_ = false;
}

void PendingUndos::answer(UndoEnd end, std::uint32_t source) {
  UndoAnswer answered;
  answered.end = end;
  answered.source = source;
  if (names_[source]) answered.blades.push_back(*names_[source]);
  answer(answered);
}

void PendingUndos::reset() {
  was_reset_ = true;
  while (next()) answer({UndoEnd::kReset, 0, {}});
}

std::optional<std::uint32_t> PendingUndos::in_stroke(const core::CutSession& session,
                                                     std::int64_t now_ns) const {
  const auto silence_ns = static_cast<std::int64_t>(1e9 * session.config().gap_limit_s);
  const auto cuts = [&](std::uint32_t source) {
    return session.in_stroke(source) && now_ns - posed_ns_[source] <= silence_ns;
  };
  const std::optional<std::uint32_t> own = now_->wish.source;
  for (std::uint32_t source = 0; source < core::kMaxSources; ++source)
    if (source != own && cuts(source)) return source;
  return own && cuts(*own) ? own : std::nullopt;
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
  if (!undone.session) {
    const UndoEnd end = undone.blades.empty() ? UndoEnd::kNoStroke : UndoEnd::kOtherBlade;
    return UndoAnswer{end, 0, undone.blades, was_reset_};
  }
  if (!now_->wish.name || now_->wish.others || undone.blades.size() == 1) return std::nullopt;
  return UndoAnswer{UndoEnd::kOtherCut, 0, {undone.blades.begin() + 1, undone.blades.end()}};
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
    if (late) answer({UndoEnd::kBehind, 0, {}});
    return nullptr;
  }
  if (const auto blade = in_stroke(session, now_ns)) {
    // An operator does not wait for another one; an admin finds them between two strokes.
    const bool of_another = now_->wish.source && blade != now_->wish.source;
    if (late || of_another) answer(UndoEnd::kInStroke, *blade);
    return nullptr;
  }
  if (late) {
    answer({UndoEnd::kBehind, 0, {}});
    return nullptr;
  }
  if (session.backlog_batches() > 0) return nullptr;
  if (!searching_ || search_strokes_ != strokes_begun_) {
    searching_ = journal_->want_undo(++search_, now_->wish.name);
    search_strokes_ = strokes_begun_;
    return nullptr;
  }
  auto undone = take_();
  if (!undone || undone->request != search_) return nullptr;  // an older one is from before the last stroke
  if (const auto why_not = refusal(*undone)) {
    answer(*why_not);
    return nullptr;
  }
  answer({UndoEnd::kDone, undone->before.source, undone->blades});
  return undone;
}

}  // namespace incise::loop
