#include "server/app/loop_watch.hpp"

#include <spdlog/spdlog.h>

namespace incise::app {
namespace {

constexpr std::int64_t kLongestStandstill_ns = 3'000'000'000;  // looks come once a second
constexpr std::uint64_t kBehind_ns = 1'000'000'000;            // a backlog worth a warning

}  // namespace

void LoopWatch::look() {
  const loop::LoopState state = stats_.state.load();
  log_late_frames();
  log_backlog(state);
  log_rejected_poses();
  if (state.frames != frames_) advanced_ns_.store(monotonic_ns(), std::memory_order_relaxed);
  frames_ = state.frames;
}

std::string LoopWatch::trouble() const {
  const std::int64_t ns = monotonic_ns() - advanced_ns_.load(std::memory_order_relaxed);
  if (ns <= kLongestStandstill_ns) return "";
  return "the loop has not advanced for " + std::to_string(ns / 1'000'000'000) + " s";
}

void LoopWatch::log_late_frames() {
  const std::uint64_t late = stats_.late_frames();
  if (late > late_) {
    std::string causes;
    for (int i = 0; i < loop::kLateCauses; ++i) {
      const std::uint64_t n = stats_.late[static_cast<std::size_t>(i)].load(std::memory_order_relaxed);
      if (n > 0)
        causes +=
            fmt::format("{}{} {}", causes.empty() ? "" : ", ", to_string(static_cast<loop::LateCause>(i)), n);
    }
    spdlog::debug("{} late frames since the start (by cause: {})", late, causes);
  }
  late_ = late;
}

void LoopWatch::log_backlog(const loop::LoopState& state) {
  const bool behind = state.recovery_ns > kBehind_ns;
  if (behind && !behind_) {
    spdlog::warn("the cut is behind: {} segments wait, about {:.1f} s; nothing is lost",
                 state.backlog_segments, static_cast<double>(state.recovery_ns) * 1e-9);
  } else if (!behind && behind_) {
    spdlog::info("the cut has caught up at revision {}", state.revision);
  }
  behind_ = behind;
}

void LoopWatch::log_rejected_poses() {
  std::uint64_t rejected = 0;
  for (int i = 0; i < core::kPoseVerdicts; ++i) {
    if (core::accepted(static_cast<core::PoseVerdict>(i))) continue;
    rejected += stats_.verdicts[static_cast<std::size_t>(i)].load(std::memory_order_relaxed);
  }
  if (rejected > rejected_) spdlog::warn("{} poses rejected since the start: see /stats", rejected);
  rejected_ = rejected;
}

}  // namespace incise::app
