#include "server/replay/replay.hpp"

#include <algorithm>
#include <utility>

namespace incise::replay {
namespace {

constexpr std::int64_t kMostPause_ns = 500'000'000;  // a longer silence in a recording is shortened to this

}  // namespace

Replay::Replay(const core::MeshData& mesh, const core::CutConfig& cut, std::vector<core::Blade> blades,
               RecordedMotion motion, std::span<const core::Field> fields)
    : mesh_(mesh), fields_(fields), cut_(cut), blades_(std::move(blades)), motion_(std::move(motion)) {
  for (const protocol::BatchMark& mark : motion_.marks)
    last_revision_ = std::max(last_revision_, mark.revision);
  restart();
}

void Replay::restart() {
  session_ = std::make_unique<core::CutSession>(mesh_, cut_, fields_);
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
    clock_ns_ += pause_ns();
    const MotionEvent& event = motion_.events[next_++];
    apply(*session_, event, event.source < blades_.size() ? blades_[event.source] : cut_.blade);
  }
  return false;
}

std::int64_t Replay::pause_ns() const {
  if (next_ == 0) return 0;
  return std::clamp<std::int64_t>(motion_.events[next_].arrival_ns - motion_.events[next_ - 1].arrival_ns, 0,
                                  kMostPause_ns);
}

}  // namespace incise::replay
