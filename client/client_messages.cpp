// Client::Impl: what the server sends, on the client's thread.

#include <utility>
#include <variant>

#include "client/client_impl.hpp"

namespace incise::client {
namespace {

constexpr int kMaxResyncs = 5;  // in a row; after that another snapshot would not help

}  // namespace

bool Client::Impl::dispatch(const protocol::Message& message, Arrival arrival) {
  arrival.sent_ns = message.envelope.sent_ns;
  {
    const std::scoped_lock lock(mutex);
    ++counts.messages_in;
    counts.bytes_in += arrival.bytes;
  }
  return std::visit([&](const auto& body) { return on(body, arrival); }, message.body);
}

// ---- State ----

bool Client::Impl::on(const protocol::Welcome& welcome, const Arrival&) {
  on_welcome(welcome);
  return true;
}

void Client::Impl::on_welcome(const protocol::Welcome& welcome) {
  // First: who has seen this Welcome and waits for a revision must not be content with the state before.
  if (!welcome.resumed) {
    state.forget();
    state.await_snapshot();
  }
  {
    const std::scoped_lock lock(mutex);
    last_welcome = welcome;
    current_status = Status::kConnected;
    error_text.clear();
    bye_reason = protocol::ByeReason::Unknown;
    started = true;
    changed.notify_all();
  }
  epoch = welcome.session;
  reconnecting = true;  // so is any connection after this one
  call(callbacks.on_welcome, welcome);
}

bool Client::Impl::on(const protocol::SnapshotBegin& begin, const Arrival&) {
  return resync(state.begin(begin, last_welcome.fields));
}

bool Client::Impl::on(const protocol::SnapshotChunk& chunk, const Arrival&) {
  const protocol::ApplyResult result = state.add(chunk);
  if (!result) return resync(result);
  call(callbacks.on_snapshot_progress, state.chunks_done(), state.chunks_total());
  return true;
}

bool Client::Impl::on(const protocol::FieldValues& values, const Arrival& arrival) {
  if (state.awaiting_snapshot() && !state.in_snapshot()) return true;
  const protocol::ApplyResult result = state.add(values);
  if (!result) return resync(result);
  if (!state.in_snapshot() && values.last) call(callbacks.on_field, values.field, arrival);
  return true;
}

bool Client::Impl::on(const protocol::SnapshotEnd& end, const Arrival&) {
  const protocol::ApplyResult result = state.end(end);
  if (!result) return resync(result);
  note_moved(0, true);
  call(callbacks.on_snapshot, end, state.snapshot_cause());
  return true;
}

bool Client::Impl::on(const protocol::Delta& delta, const Arrival& arrival) {
  if (state.awaiting_snapshot()) return true;  // sent before the server knew
  const protocol::ApplyResult result = state.apply(delta);
  if (!result) return resync(result);
  note_moved(delta.steps.size(), false);
  if (state.boxed()) {
    call(callbacks.on_part_delta, state.part(), delta, arrival);
  } else {
    call(callbacks.on_delta, state.volume(), delta, arrival);
  }
  return true;
}

bool Client::Impl::on(const protocol::SurfaceDelta& delta, const Arrival& arrival) {
  if (state.awaiting_snapshot()) return true;
  const protocol::ApplyResult result = state.apply(delta);
  if (!result) return resync(result);
  note_moved(delta.steps.size(), false);
  call(callbacks.on_surface_delta, state.surface(), delta, arrival);
  return true;
}

void Client::Impl::note_moved(std::size_t steps, bool snapshot) {
  resyncs_in_a_row = 0;
  const std::scoped_lock lock(mutex);
  counts.steps += steps;
  ++(snapshot ? counts.snapshots : counts.deltas);
  changed.notify_all();
}

bool Client::Impl::resync(const protocol::ApplyResult& result) {
  if (result) return true;
  state.await_snapshot();
  {
    const std::scoped_lock lock(mutex);
    ++counts.resyncs;
  }
  call(callbacks.on_resync, result.text);
  if (++resyncs_in_a_row > kMaxResyncs || result.error == protocol::ApplyError::LimitReached) {
    note_failure("cannot hold the server's state: " + result.text);
    closing = true;  // another connection would fare no better
    return false;
  }
  protocol::Resync message;
  message.revision = state.revision();
  message.reason = result.text.substr(0, protocol::kMaxNameBytes);
  send(message);
  return true;
}

// ---- The rest ----

bool Client::Impl::on(const protocol::Ping& ping, const Arrival& arrival) {
  send(protocol::Pong{ping.nonce, ping.sent_ns, arrival.received_ns});
  return true;
}

bool Client::Impl::on(const protocol::Pong& pong, const Arrival& arrival) {
  server_clock.add(pong, arrival.received_ns);
  return true;
}

bool Client::Impl::on(const protocol::Error& error, const Arrival&) {
  if (error.fatal) note_failure(error.text);
  call(callbacks.on_error, error);
  return true;  // Bye follows a fatal one
}

bool Client::Impl::on(const protocol::Bye& bye, const Arrival&) {
  {
    const std::scoped_lock lock(mutex);
    bye_reason = bye.reason;
  }
  note_failure(bye.text.empty() ? "the server said goodbye" : bye.text);
  // Coming back would fight the operator who took the blade, or the server that refused us.
  if (bye.reason == protocol::ByeReason::HandedOver || bye.reason == protocol::ByeReason::Refused)
    closing = true;
  return false;
}

bool Client::Impl::on(const protocol::PoseReport& report, const Arrival&) {
  {
    const std::scoped_lock lock(mutex);
    last_report = report;
    changed.notify_all();
  }
  call(callbacks.on_report, report);
  return true;
}

bool Client::Impl::on(const protocol::PositionsReport& report, const Arrival&) {
  call(callbacks.on_positions_report, report);
  return true;
}

bool Client::Impl::on(const protocol::BladeLoad& load, const Arrival&) {
  call(callbacks.on_blade_load, load);
  return true;
}

bool Client::Impl::on(const protocol::Force& force, const Arrival&) {
  call(callbacks.on_force, force);
  return true;
}

bool Client::Impl::on(const protocol::Stats& stats, const Arrival&) {
  call(callbacks.on_stats, stats);
  return true;
}

}  // namespace incise::client
