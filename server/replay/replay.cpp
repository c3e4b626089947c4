#include "server/replay/replay.hpp"

#include <algorithm>
#include <utility>

namespace incise::replay {
namespace {

constexpr std::int64_t kMostPause_ns = 500'000'000;  // a longer silence in a recording is shortened to this

}  // namespace

Replay::Replay(const core::MeshData& mesh, const core::CutConfig& cut, std::vector<core::Blade> blades,
               RecordedMotion motion, std::span<const core::Field> fields)
    : Replay([&mesh, cut, fields] { return std::make_unique<core::CutSession>(mesh, cut, fields); }, cut,
             std::move(blades), std::move(motion)) {}

Replay::Replay(Fresh fresh, const core::CutConfig& cut, std::vector<core::Blade> blades,
               RecordedMotion motion)
    : fresh_(std::move(fresh)), cut_(cut), blades_(std::move(blades)), motion_(std::move(motion)) {
  for (const protocol::BatchMark& mark : motion_.marks)
    last_revision_ = std::max(last_revision_, mark.revision);
  restart();
}

void Replay::restart() {
  session_ = fresh_();
  next_ = 0;
  clock_ns_ = 0;
}

bool Replay::advance(core::Delta& delta) {
  core::WorkBudget budget = core::WorkBudget::unlimited();
  if (session_->advance(budget, delta) == core::CutSession::Progress::kCommitted) {
    last_revision_ = std::max(last_revision_, session_->revision());
    return true;
  }
  if (next_ < motion_.events.size()) {
    clock_ns_ += pause_ns(next_);
    const MotionEvent& event = motion_.events[next_++];
    apply(*session_, event, event.source < blades_.size() ? blades_[event.source] : cut_.blade);
  }
  return false;
}

std::int64_t Replay::pause_ns(std::size_t event) const {
  if (event == 0) return 0;
  return std::clamp<std::int64_t>(motion_.events[event].arrival_ns - motion_.events[event - 1].arrival_ns, 0,
                                  kMostPause_ns);
}

void Replay::describe(protocol::ReplayState& state) const {
  const std::size_t marks = motion_.marks.size();
  for (std::size_t i = 0; i < marks; ++i) {
    if (motion_.marks[i].revision != i + 1) return;  // not of each revision from the first on
  }
  std::size_t event = 0;
  std::int64_t clock_ns = 0;
  for (std::size_t i = 0; i < marks; ++i) {
    const std::size_t before = std::min(motion_.events_before[i], motion_.events.size());
    for (; event < before; ++event) clock_ns += pause_ns(event);
    state.revision_ms.push_back(static_cast<std::uint32_t>(clock_ns / 1'000'000));
    state.revision_sources.push_back(motion_.marks[i].source);
    state.revision_strokes.push_back(motion_.marks[i].stroke);
  }
}

}  // namespace incise::replay
