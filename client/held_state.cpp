#include "client/held_state.hpp"

#include <utility>

namespace incise::client {
namespace {

protocol::ApplyResult wrong_hash() {
  return {protocol::ApplyError::HashMismatch, "the hash of the whole replica differs from the one it keeps"};
}

}  // namespace

// Changes the replica of the view in force.
template <class F>
protocol::ApplyResult HeldState::change(F&& function) {
  const std::scoped_lock lock(mutex_);
  if (view_ == protocol::View::Surface) return function(surface_);
  return boxed_ ? function(part_) : function(volume_);
}

// Whether the delta crosses a revision at which the whole replica is hashed.
template <class D>
bool HeldState::due_for_full_check(const D& delta) const {
  const std::uint64_t every = full_check_interval_;
  return every > 0 && delta.revision / every != delta.base_revision / every;
}

protocol::ApplyResult HeldState::begin(const protocol::SnapshotBegin& begin,
                                       std::span<const protocol::FieldFacts> fields) {
  view_ = begin.view;
  boxed_ = begin.box.has_value();
  snapshot_cause_ = begin.cause;
  in_snapshot_ = true;
  if (protocol::ApplyResult result = fields_.begin(begin, fields); !result) return result;
  return change([&](auto& replica) { return replica.begin(begin); });
}

protocol::ApplyResult HeldState::add(const protocol::SnapshotChunk& chunk) {
  return change([&](auto& replica) {
    protocol::ApplyResult result = replica.chunk(chunk);
    chunks_done_ = replica.chunks_done();
    chunks_total_ = replica.chunks_total();
    return result;
  });
}

protocol::ApplyResult HeldState::add(const protocol::FieldValues& values) {
  const std::scoped_lock lock(mutex_);
  return fields_.values(values, volume_);
}

protocol::ApplyResult HeldState::end(const protocol::SnapshotEnd& end) {
  in_snapshot_ = false;
  protocol::ApplyResult result = change([&](auto& replica) {
    protocol::ApplyResult ended = replica.end(end);
    return ended ? fields_.end(volume_) : ended;
  });
  if (!result) return result;
  awaiting_snapshot_ = false;
  revision_ = end.revision;
  state_hash_ = end.state_hash;
  whole_ = true;  // after the revision, as others read both
  return result;
}

protocol::ApplyResult HeldState::apply(const protocol::Delta& delta) {
  {
    const std::scoped_lock lock(mutex_);
    protocol::ApplyResult result = boxed_ ? part_.apply(delta) : volume_.apply(delta);
    if (result && !boxed_) result = fields_.apply(delta);
    if (!result) return result;
  }
  if (due_for_full_check(delta) && (boxed_ ? part_.compute_part_hash() != part_.part_hash()
                                           : volume_.compute_state_hash() != volume_.state_hash())) {
    return wrong_hash();
  }
  revision_ = delta.revision;
  state_hash_ = delta.state_hash;
  return {};
}

protocol::ApplyResult HeldState::apply(const protocol::SurfaceDelta& delta) {
  {
    const std::scoped_lock lock(mutex_);
    protocol::ApplyResult result = surface_.apply(delta);
    if (!result) return result;
  }
  if (due_for_full_check(delta) && surface_.compute_surface_hash() != surface_.surface_hash())
    return wrong_hash();
  revision_ = delta.revision;
  state_hash_ = delta.state_hash;
  return {};
}

}  // namespace incise::client
