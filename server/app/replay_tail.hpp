#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "server/core/session/cut_session.hpp"
#include "server/stream/published_delta.hpp"

namespace incise::app {

// The last steps of a session that is replayed, and the state before them: a server that resumes begins there, so that clients
// which come back a few steps behind get these and no snapshot. Holds between half of `max_bytes` and all of it once there is
// so much, and at most two whole states.
class ReplayTail {
 public:
  // `session` before the replay.
  ReplayTail(const core::CutSession& session, std::uint64_t session_id, std::size_t max_bytes);
  // `delta` has just been committed.
  void note(const core::CutSession& session, const core::Delta& delta);

  using Deltas = std::vector<std::shared_ptr<const stream::PublishedDelta>>;
  struct Tail {
    stream::InitialState before;
    Deltas deltas;
  };
  // `session` after the replay. This is empty then.
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
  Run older_, newer_;  // the newer one follows on the older one
};

}  // namespace incise::app
