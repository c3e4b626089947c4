#include "server/app/replay_tail.hpp"

#include <utility>

#include "server/app/stream_setup.hpp"
#include "server/base/clock.hpp"

namespace incise::app {
namespace {

// About its size on the wire.
std::size_t bytes_of(const core::Delta& d) {
  std::size_t bytes =
      sizeof d + 28 * d.moved.size() + 40 * d.added_positions.size() + 52 * d.blends.size() +
      24 * (d.moved_rest.size() + d.added_rest.size()) + 28 * d.upserted.size() +
      4 * (d.removed.size() + d.elders.size() + d.boundary_upserted.size() + d.boundary_removed.size()) +
      12 * d.pieces.size();
  return bytes;
}

}  // namespace

ReplayTail::ReplayTail(const core::CutSession& session, std::uint64_t session_id, std::size_t max_bytes)
    : session_id_(session_id), max_bytes_(max_bytes) {
  // A batch in progress has already changed the mesh: then the tail begins with the first commit.
  if (session.backlog_batches() == 0) newer_ = run_from(session);
}

ReplayTail::Run ReplayTail::run_from(const core::CutSession& session) const {
  return {std::make_shared<stream::InitialState>(replay::initial_state(session, session_id_)), {}, 0};
}

void ReplayTail::note(const core::CutSession& session, const core::Delta& delta) {
  if (newer_.before) {
    auto published = std::make_shared<stream::PublishedDelta>();
    published->delta = delta;
    published->arrival_ns = published->drain_ns = published->cut_ns = monotonic_ns();
    newer_.deltas.push_back(std::move(published));
    newer_.bytes += bytes_of(delta);
    if (newer_.bytes < max_bytes_ / 2) return;
    older_ = std::move(newer_);
  }
  newer_ = run_from(session);
}

ReplayTail::Tail ReplayTail::finish(const core::CutSession& session) {
  if (!newer_.before) newer_ = run_from(session);
  if (!older_.before) std::swap(older_, newer_);
  Tail tail{std::move(*older_.before), std::move(older_.deltas)};
  tail.deltas.insert(tail.deltas.end(), newer_.deltas.begin(), newer_.deltas.end());
  older_ = newer_ = {};
  return tail;
}

}  // namespace incise::app
