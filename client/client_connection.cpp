// Client::Impl: the connection, which the client's thread runs.

#include <boost/asio/as_tuple.hpp>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/use_awaitable.hpp>

#include "client/client_impl.hpp"
#include "server/base/clock.hpp"

namespace incise::client {
namespace {

using boost::system::error_code;
using std::chrono::milliseconds;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);
constexpr std::chrono::seconds kPingEvery{1};
constexpr std::int64_t kSilence_ns = 15'000'000'000;  // with a ping a second unanswered, the server is gone

}  // namespace

asio::awaitable<void> Client::Impl::live() {
  milliseconds pause{100};
  for (;;) {
    std::string why;
    try {
      co_await connect_once();
      pause = milliseconds(100);
      co_await serve();
      why = take_failure();
    } catch (const ConnectError& error) {
      why = error.what();
      const std::scoped_lock lock(mutex);
      refusal = error.code;
    }
    const bool again = end_connection(why);
    if (!again) break;
    retry_timer.expires_after(pause);
    co_await retry_timer.async_wait(kTuple);
    pause = std::min(2 * pause, milliseconds(2000));
    if (closing) break;
  }
  const std::scoped_lock lock(mutex);
  current_status = Status::kClosed;
  started = true;
  changed.notify_all();
}

void Client::Impl::note_failure(const std::string& why) {
  const std::scoped_lock lock(mutex);
  if (failure.empty()) failure = why;
}

std::string Client::Impl::take_failure() {
  const std::scoped_lock lock(mutex);
  return std::exchange(failure, {});
}

void Client::Impl::throw_failure(const std::string& what, protocol::ErrorCode code) {
  std::string why = take_failure();
  if (why.empty()) why = what;
  throw ConnectError(host + ":" + std::to_string(port) + ": " + why, code);
}

bool Client::Impl::end_connection(const std::string& why) {
  if (link) link->close();
  link.reset();
  ping_timer.cancel();
  outbox_wake.cancel();
  bool again = false, was_connected = false;
  {
    const std::scoped_lock lock(mutex);
    was_connected = current_status == Status::kConnected && !closed;  // close() needs no callback
    again = options.reconnect && started && !closing;
    error_text = why;
    current_status = again ? Status::kReconnecting : Status::kClosed;
    if (!again) started = true;  // start() waits for this, too
    outbox.clear();
    outbox_bytes = 0;
    changed.notify_all();
  }
  if (was_connected) call(callbacks.on_disconnect, why);
  return again;
}

protocol::Hello Client::Impl::hello() const {
  protocol::Hello hello;
  hello.role = options.role;
  hello.view = state.view();
  hello.client_name = options.client_name;
  hello.client_version = INCISE_VERSION;
  hello.token = options.token;
  hello.max_rate_hz = options.max_rate_hz;
  hello.box = options.box;
  hello.source_name = options.source_name;
  hello.blade = options.blade;
  hello.load_rate_hz = options.load_rate_hz;
  hello.fields = options.fields;
  // After a lost connection the server may still count the blade as held by it.
  hello.take_over = options.take_over || reconnecting;
  if (reconnecting && state.whole() && !state.awaiting_snapshot()) {
    hello.resume_session = epoch;
    hello.resume_revision = state.revision();
    hello.resume_hash = state.state_hash();
  }
  return hello;
}

asio::awaitable<void> Client::Impl::connect_once() {
  const auto deadline = Clock::now() + seconds_of(options.connect_timeout_s);
  link = std::shared_ptr<Link>(co_await open_link(host, port, options, deadline));
  asio::steady_timer late(io, deadline);
  late.async_wait([this, weak = std::weak_ptr<Link>(link)](error_code ec) {
    if (ec) return;
    if (const auto same = weak.lock()) {
      note_failure("no Welcome in time");
      same->close();
    }
  });
  const protocol::Frame frame = protocol::encode(hello(), {++sequence, monotonic_ns()});
  const error_code written = co_await link->write(frame);
  if (written) throw_failure(written.message());
  const Link::Received received = co_await link->read();
  late.cancel();
  if (!received.closed.empty()) {
    const bool silent = received.closed == error_code(asio::error::eof).message();
    throw_failure(silent && !options.tls ? kMaybeTls : received.closed);
  }
  last_received_ns = monotonic_ns();
  const protocol::DecodeResult decoded = protocol::decode(received.body);
  if (!decoded) throw_failure(decoded.error);
  if (const auto* error = std::get_if<protocol::Error>(&decoded.message->body))
    throw_failure(error->text, error->code);
  if (const auto* bye = std::get_if<protocol::Bye>(&decoded.message->body)) throw_failure(bye->text);
  const auto* welcome = std::get_if<protocol::Welcome>(&decoded.message->body);
  if (!welcome) throw_failure(std::string("Welcome expected, received ") + name_of(decoded.message->body));
  {
    // A Welcome on a connection that goes on, after a reset or an undo, is none of this: what was reported of poses still holds.
    const std::scoped_lock lock(mutex);
    last_report = {};
    if (reconnecting) ++counts.reconnects;
  }
  on_welcome(*welcome);
}

asio::awaitable<void> Client::Impl::serve() {
  asio::co_spawn(io, write_all(link), asio::detached);
  asio::co_spawn(io, ping_all(link), asio::detached);
  const std::shared_ptr<Link> mine = link;
  for (;;) {
    const Link::Received received = co_await mine->read();
    if (!received.closed.empty()) {
      note_failure("connection lost: " + received.closed);
      co_return;
    }
    const Arrival arrival{monotonic_ns(), 0, received.body.size()};
    last_received_ns = arrival.received_ns;
    protocol::DecodeResult decoded = protocol::decode(received.body);
    if (!decoded) {
      note_failure("the server sent something that is not a message: " + decoded.error);
      co_return;
    }
    const bool go_on = dispatch(*decoded.message, arrival);
    if (!go_on) co_return;
  }
}

asio::awaitable<void> Client::Impl::write_all(std::shared_ptr<Link> mine) {
  for (;;) {
    std::shared_ptr<const protocol::Frame> frame;
    {
      const std::scoped_lock lock(mutex);
      if (!outbox.empty()) {
        frame = std::move(outbox.front());
        outbox.pop_front();
      }
    }
    if (!frame) {
      if (link != mine) co_return;
      outbox_wake.expires_at(Clock::time_point::max());
      co_await outbox_wake.async_wait(kTuple);
      if (link != mine) co_return;
      continue;
    }
    const error_code ec = co_await mine->write(*frame);
    {
      const std::scoped_lock lock(mutex);
      outbox_bytes -= std::min(outbox_bytes, frame->tcp().size());
      counts.bytes_out += frame->tcp().size();
      changed.notify_all();
    }
    if (ec) {
      mine->close();
      co_return;
    }
  }
}

asio::awaitable<void> Client::Impl::ping_all(std::shared_ptr<Link> mine) {
  while (link == mine) {
    if (monotonic_ns() - last_received_ns > kSilence_ns) {
      note_failure("the server is silent");
      mine->close();
      co_return;
    }
    send(protocol::Ping{++ping_nonce, monotonic_ns()});
    ping_timer.expires_after(kPingEvery);
    co_await ping_timer.async_wait(kTuple);
  }
}

}  // namespace incise::client
