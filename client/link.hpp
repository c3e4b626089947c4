#pragma once

// One connection of the client, by TCP or WebSocket, with TLS or without. Not installed: Asio stays in here.

#include <boost/asio/awaitable.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/system/error_code.hpp>
#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <utility>

#include "client/client.hpp"
#include "protocol/framing.hpp"
#include "protocol/net/net_stream.hpp"

namespace incise::client {

namespace asio = boost::asio;

// What a server with TLS looks like to a client without.
inline constexpr const char* kMaybeTls =
    "the connection was closed without an answer; a server with a certificate needs TLS (tls:// or wss://)";

// Thread: the client's. Owns: the socket.
class Link {
 public:
  struct Received {
    std::span<const std::byte> body;  // valid until the next read
    std::string closed;               // why no more will come; empty: there is a message

    // Functions rather than braces where a coroutine returns one: g++ 12 destroys the members of a braced
    // aggregate in a co_return twice.
    static Received message(std::span<const std::byte> body) {
      Received received;
      received.body = body;
      return received;
    }
    static Received end(std::string why) {
      Received received;
      received.closed = std::move(why);
      return received;
    }
  };
  virtual ~Link() = default;
  virtual asio::awaitable<Received> read() = 0;
  // Writes one frame, which must stay until this is done. One call at a time.
  virtual asio::awaitable<boost::system::error_code> write(const protocol::Frame& frame) = 0;
  // Reads and writes under way return an error.
  virtual void close() = 0;
};

// A connection before anything is said on it, with TLS's handshake done where the options have TLS.
struct OpenStream {
  std::shared_ptr<void> tls;  // the stream refers to it
  net::NetStream stream;
};
// Throws ConnectError. The stream's operations expire at `deadline`.
asio::awaitable<OpenStream> open_stream(std::string host, std::uint16_t port, const Options& options,
                                        std::chrono::steady_clock::time_point deadline);

// Throws ConnectError. `deadline` is for connecting and all handshakes together.
asio::awaitable<std::unique_ptr<Link>> open_link(std::string host, std::uint16_t port, const Options& options,
                                                 std::chrono::steady_clock::time_point deadline);

}  // namespace incise::client
