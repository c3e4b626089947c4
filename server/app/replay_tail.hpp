#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "server/core/session/cut_session.hpp"
#include "server/stream/published_delta.hpp"

namespace incise::app {

// The last steps of a session that is replayed, and the state before them. A server that resumes begins there, so that
// clients that return a few steps behind get these steps and no snapshot. Holds at most two whole states, and steps of
// `max_bytes`, or at least half of that once there are so many.
class ReplayTail {
 public:
  // `session` before the replay.
  ReplayTail(const core::CutSession& session, std::uint64_t session_id, std::size_t max_bytes);
  // Call it when `delta` has just been committed.
  void note(const core::CutSession& session, const core::Delta& delta);

  using Deltas = std::vector<std::shared_ptr<const stream::PublishedDelta>>;
  struct Tail {
    stream::InitialState before;
    Deltas deltas;
  };
  // `session` after the replay. Leaves this empty.
  Tail finish(const core::CutSession& session);

 private:
  struct Run {
    std::shared_ptr<stream::InitialState> before;  // null: there is none
    Deltas deltas;
    std::size_t bytes = 0;
  };
  Run run_from(const core::CutSession& session) const;

  std::uint64_t session_id_;
  std::size_t max_bytes_;
  Run older_, newer_;  // the newer one continues the older one
};

}  // namespace incise::app
