#pragma once

#include <boost/asio/awaitable.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>

#include "client/clock_estimate.hpp"
#include "client/link.hpp"
#include "protocol/framing.hpp"
#include "server/relay/upstream.hpp"

namespace incise::relay {

namespace asio = boost::asio;

// One connection to another server, from connecting to its end: sends Hello, answers pings and sends some, passes on what comes.
//
// Thread: the io_context's, all of it. Owns: the socket.
class Connection : public std::enable_shared_from_this<Connection> {
 public:
  // Why it ended: with a code the server refused us; with a reason it said goodbye; with neither there is no server, or it is lost.
  struct End {
    protocol::ErrorCode code = protocol::ErrorCode::Unknown;
    protocol::ByeReason reason = protocol::ByeReason::Unknown;
    std::string text;
  };
  class Owner {
   public:
    // Welcome is the first. Pings, pongs and Bye are seen to, and a fatal Error is in End.
    virtual void on_message(const protocol::Message& message) = 0;
    // Once, unless close() was called. There was a Welcome, or not.
    virtual void on_end(const End& end, bool welcomed) = 0;

   protected:
    ~Owner() = default;
  };

  // `owner` must live until on_end() or close().
  Connection(asio::io_context& io, Origin server, Owner& owner);

  void open(protocol::Hello hello);
  // Queues a message; returns its sequence.
  std::uint64_t send(const protocol::Body& body);
  // What waits for the network.
  std::size_t waiting_bytes() const { return waiting_bytes_; }
  // Says goodbye behind what waits, and ends; the owner hears nothing more. Without a goodbye: at once.
  void close(bool goodbye = true);
  // The server's clock minus CLOCK_MONOTONIC here, and the round trip that this comes from.
  const client::ClockEstimate& clock() const { return clock_; }

 private:
  asio::awaitable<void> run(protocol::Hello hello);
  asio::awaitable<End> talk(protocol::Hello hello);
  asio::awaitable<End> read_all();
  asio::awaitable<void> write_all();
  asio::awaitable<void> ping_all();
  bool see_to(const protocol::Message& message, End& end);

  asio::io_context& io_;
  const Origin server_;
  Owner* owner_;  // null: closed
  std::shared_ptr<client::Link> link_;
  client::ClockEstimate clock_;
  asio::steady_timer wake_writer_, ping_timer_;
  std::deque<protocol::Frame> outbox_;
  std::size_t waiting_bytes_ = 0;
  std::uint64_t sequence_ = 0, nonce_ = 0;
  std::int64_t received_ns_ = 0;
  bool welcomed_ = false, leaving_ = false, ended_ = false;
};

}  // namespace incise::relay
