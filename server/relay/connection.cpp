#include "server/relay/connection.hpp"

#include <boost/asio/as_tuple.hpp>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <chrono>
#include <exception>
#include <utility>

#include "server/base/clock.hpp"

namespace incise::relay {
namespace {

using std::chrono::steady_clock;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);
constexpr std::chrono::seconds kConnectTime{5};  // for Welcome to come
constexpr std::chrono::seconds kPingEvery{1};
constexpr std::int64_t kSilence_ns = 10'000'000'000;  // pings unanswered for so long: the server is gone
constexpr std::chrono::seconds kGoodbyeTime{1};

}  // namespace

Connection::Connection(asio::io_context& io, Origin server, Owner& owner)
    : io_(io), server_(std::move(server)), owner_(&owner), wake_writer_(io), ping_timer_(io) {}

void Connection::open(protocol::Hello hello) {
  asio::co_spawn(io_, run(std::move(hello)), asio::detached);
}

std::uint64_t Connection::send(const protocol::Body& body) {
  outbox_.push_back(protocol::encode(body, {++sequence_, monotonic_ns()}));
  waiting_bytes_ += outbox_.back().tcp().size();
  wake_writer_.cancel();
  return sequence_;
}

void Connection::close(bool goodbye) {
  owner_ = nullptr;
  if (ended_ || leaving_) return;
  leaving_ = true;
  if (!welcomed_ || !goodbye) {
    ended_ = true;
    if (link_) link_->close();
  } else {
    send(protocol::Bye{protocol::ByeReason::Done, ""});
    // Until the server has closed, or for a while.
    ping_timer_.expires_after(kGoodbyeTime);
    ping_timer_.async_wait([self = shared_from_this()](boost::system::error_code error) {
      if (!error) self->link_->close();
    });
  }
}

asio::awaitable<void> Connection::run(protocol::Hello hello) {
  const auto self = shared_from_this();
  End end;
  try {
    end = co_await talk(std::move(hello));
  } catch (const std::exception& error) {
    end.text = error.what();
  }
  ended_ = true;
  if (link_) link_->close();
  wake_writer_.cancel();
  ping_timer_.cancel();
  if (Owner* const owner = std::exchange(owner_, nullptr)) owner->on_end(end, welcomed_);
}

asio::awaitable<Connection::End> Connection::talk(protocol::Hello hello) {
  const auto deadline = steady_clock::now() + kConnectTime;
  link_ = co_await client::open_link(server_.host, server_.tcp_port, server_.options, deadline);
  if (ended_) co_return End{};
  asio::steady_timer late(io_, deadline);
  late.async_wait([this, weak = weak_from_this()](boost::system::error_code error) {
    const auto alive = weak.lock();
    if (!error && alive && !welcomed_) link_->close();
  });
  const protocol::Frame frame = protocol::encode(hello, {++sequence_, monotonic_ns()});
  const boost::system::error_code error = co_await link_->write(frame);
  if (error) throw client::ConnectError(error.message());
  End end = co_await read_all();
  if (!welcomed_ && end.text.empty()) end.text = "no Welcome came";
  co_return end;
}

asio::awaitable<Connection::End> Connection::read_all() {
  End end;
  for (;;) {
    const client::Link::Received received = co_await link_->read();
    if (!received.closed.empty()) {
      if (end.text.empty()) end.text = "the connection was lost: " + received.closed;
      co_return end;
    }
    received_ns_ = monotonic_ns();
    const protocol::DecodeResult decoded = protocol::decode(received.body);
    if (!decoded) {
      end.text = "it sent something that is not a message: " + decoded.error;
      co_return end;
    }
    if (!see_to(*decoded.message, end)) co_return end;
  }
}

// False: it is over.
bool Connection::see_to(const protocol::Message& message, End& end) {
  const protocol::Body& body = message.body;
  if (const auto* error = std::get_if<protocol::Error>(&body); error && error->fatal) {
    end.code = error->code == protocol::ErrorCode::Unknown ? protocol::ErrorCode::Internal : error->code;
    end.text = error->text;
    return true;  // Bye follows
  }
  if (const auto* bye = std::get_if<protocol::Bye>(&body)) {
    end.reason = bye->reason == protocol::ByeReason::Unknown ? protocol::ByeReason::Done : bye->reason;
    if (end.text.empty()) end.text = bye->text.empty() ? "the server said goodbye" : bye->text;
    return false;
  }
  if (!welcomed_) {
    if (!std::holds_alternative<protocol::Welcome>(body)) {
      end.text = std::string("Welcome expected, received ") + name_of(body);
      return false;
    }
    welcomed_ = true;
    asio::co_spawn(io_, write_all(), asio::detached);
    asio::co_spawn(io_, ping_all(), asio::detached);
  }
  if (const auto* ping = std::get_if<protocol::Ping>(&body)) {
    if (!leaving_) send(protocol::Pong{ping->nonce, ping->sent_ns, received_ns_});
  } else if (const auto* pong = std::get_if<protocol::Pong>(&body)) {
    clock_.add(*pong, received_ns_);
  }
  if (owner_) owner_->on_message(message);
  return !ended_;
}

asio::awaitable<void> Connection::write_all() {
  const auto self = shared_from_this();
  while (!ended_) {
    if (outbox_.empty()) {
      wake_writer_.expires_at(steady_clock::time_point::max());
      co_await wake_writer_.async_wait(kTuple);
      continue;
    }
    const protocol::Frame frame = std::move(outbox_.front());
    outbox_.pop_front();
    const boost::system::error_code error = co_await link_->write(frame);
    waiting_bytes_ -= frame.tcp().size();
    if (error) link_->close();
    if (error) co_return;
  }
}

asio::awaitable<void> Connection::ping_all() {
  const auto self = shared_from_this();
  while (!ended_ && !leaving_) {
    if (monotonic_ns() - received_ns_ > kSilence_ns) {
      link_->close();
      co_return;
    }
    send(protocol::Ping{++nonce_, monotonic_ns()});
    ping_timer_.expires_after(kPingEvery);
    co_await ping_timer_.async_wait(kTuple);
  }
}

}  // namespace incise::relay
