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

// One message from a peer, or why no more will come.
struct Received {
  std::span<const std::byte> body;   // valid until the next read
  boost::system::error_code closed;  // the connection has ended: no answer is possible
  std::string error;                 // the bytes are not a message: answer, then close
  bool too_long = false;             // because of their length

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

// A connection that carries messages: TCP with a length before each, or WebSocket frames; with TLS or without.
//
// Thread: the stream thread. Owns: the socket.
class Transport {
 public:
  virtual ~Transport() = default;
  // Waits for the next message, of at most set_max_bytes().
  virtual asio::awaitable<Received> read() = 0;
  virtual void set_max_bytes(std::size_t max_bytes) = 0;
  // Writes all frames. One call at a time; the frames must stay until `done`, which is never called from within.
  virtual void write(std::span<const SharedFrame> frames,
                     std::function<void(boost::system::error_code)> done) = 0;
  // Reads and drops everything until the peer has closed too, so that what was written last still arrives.
  virtual asio::awaitable<void> discard() = 0;
  // Tells the peer that nothing more will come, after the last write; a read may be under way. `keep` is held until
  // that is done.
  virtual void shut_down(std::shared_ptr<void> keep) = 0;
  // Ends the connection now: reads and writes under way return an error.
  virtual void close() = 0;
  virtual std::string peer() const = 0;
  virtual asio::any_io_executor executor() = 0;
};

// "address:port".
std::string name_of(const asio::ip::tcp::endpoint& endpoint);

std::unique_ptr<Transport> make_tcp_transport(NetStream stream);
// Answers the upgrade request. Null if the handshake fails.
asio::awaitable<std::unique_ptr<Transport>> accept_websocket(NetStream stream, const HttpRequest& request);

}  // namespace incise::stream
