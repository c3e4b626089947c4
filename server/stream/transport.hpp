#pragma once

#include <boost/asio/any_io_executor.hpp>
#include <boost/asio/awaitable.hpp>
#include <cstddef>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <utility>

#include "protocol/net/web_socket.hpp"
#include "server/stream/mirror.hpp"

namespace incise::stream {

namespace asio = boost::asio;
using net::HttpRequest;
using net::NetStream;

// One message a peer sent, or why no more will come.
struct Received {
  std::span<const std::byte> body;   // valid until the next read
  boost::system::error_code closed;  // the connection's end: nothing can be answered
  std::string error;                 // bytes that are no message: answer it, then close
  bool too_long = false;             // what is wrong is the length

  // Functions rather than braces where a coroutine returns one: g++ 12 destroys the members of a braced aggregate
  // in a co_return twice.
  static Received message(std::span<const std::byte> body) {
    Received received;
    received.body = body;
    return received;
  }
  static Received end(boost::system::error_code closed) {
    Received received;
    received.closed = closed;
    return received;
  }
  static Received bad(std::string error, bool too_long) {
    Received received;
    received.error = std::move(error);
    received.too_long = too_long;
    return received;
  }
};

// A connection that carries messages: TCP with a length in front, or WebSocket frames; with TLS or without.
//
// Thread: the stream thread. Owns: the socket.
class Transport {
 public:
  virtual ~Transport() = default;
  // Waits for the next message, of at most as many bytes as set_max_bytes() said.
  virtual asio::awaitable<Received> read() = 0;
  virtual void set_max_bytes(std::size_t max_bytes) = 0;
  // Writes all frames; one call at a time, the frames stay until `done`, which is never called from within.
  virtual void write(std::span<const SharedFrame> frames,
                     std::function<void(boost::system::error_code)> done) = 0;
  // Reads on and forgets what it reads until the peer has closed too, so that what was written last still
  // arrives.
  virtual asio::awaitable<void> discard() = 0;
  // Says to the peer that nothing more will come. After the last write is done; a read may be under way.
  // `keep` stays until that is said.
  virtual void shut_down(std::shared_ptr<void> keep) = 0;
  // Ends the connection now: reads and writes under way come back with an error.
  virtual void close() = 0;
  virtual std::string peer() const = 0;
  virtual asio::any_io_executor executor() = 0;
};

// "address:port".
std::string name_of(const asio::ip::tcp::endpoint& endpoint);

std::unique_ptr<Transport> make_tcp_transport(NetStream stream);
// Answers the upgrade request; null where the handshake fails.
asio::awaitable<std::unique_ptr<Transport>> accept_websocket(NetStream stream, const HttpRequest& request);

}  // namespace incise::stream
