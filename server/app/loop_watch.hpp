#pragma once

#include <atomic>
#include <cstdint>
#include <string>

#include "server/base/clock.hpp"
#include "server/loop/loop_stats.hpp"

namespace incise::app {

// Looks at the loop's counters once a second: logs what the loop cannot log itself, and knows whether it still runs.
//
// Thread: look() by one; trouble() by any.
class LoopWatch {
 public:
  explicit LoopWatch(const loop::LoopStats& stats) : stats_(stats) {}
  void look();
  // Why the server is not healthy, for /healthz; empty if it is.
  std::string trouble() const;

 private:
  void log_late_frames();
  void log_backlog(const loop::LoopState& state);
  void log_rejected_poses();

  const loop::LoopStats& stats_;
  std::uint64_t late_ = 0, rejected_ = 0, frames_ = 0;  // at the last look
  bool behind_ = false;
  std::atomic<std::int64_t> advanced_ns_{monotonic_ns()};  // when a look last saw new frames
};

}  // namespace incise::app
