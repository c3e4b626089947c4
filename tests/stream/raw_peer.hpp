#pragma once

// A TCP peer that may send anything, by plain sockets: what the client library would never do.

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "protocol/framing.hpp"

namespace incise::stream {

class RawPeer {
 public:
  // Connects to 127.0.0.1; reads time out after 20 s. `receive_buffer`: bytes for the kernel's, 0 for its
  // default.
  explicit RawPeer(std::uint16_t port, int receive_buffer = 0);
  // A server's side of a connection: the next one that comes to `listener`, a listening socket.
  static std::unique_ptr<RawPeer> accept(int listener);
  ~RawPeer();
  RawPeer(const RawPeer&) = delete;
  RawPeer& operator=(const RawPeer&) = delete;

  bool connected() const { return fd_ >= 0; }
  // False where the server has closed.
  bool send(std::span<const std::byte> bytes);
  bool send(std::string_view text);
  bool send(const protocol::Body& body, std::uint64_t sequence = 1);

  struct Message {
    std::vector<std::byte> bytes;
    protocol::Message message;
  };
  // The next message; nothing at the end of the stream or of the time.
  std::optional<Message> receive();
  // Messages until one of type T comes, for half a minute: a server may send others for ever.
  template <class T>
  std::optional<Message> receive_until() {
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(30);
    while (std::chrono::steady_clock::now() < end) {
      auto received = receive();
      if (!received || std::holds_alternative<T>(received->message.body)) return received;
    }
    return std::nullopt;
  }
  // Whether the server closes the connection, with whatever it sends before.
  bool closes();
  // All that comes until the server closes, or until `enough` bytes are there.
  std::string read_all(std::size_t enough = SIZE_MAX);
  // All that comes until an HTTP head is complete, or the stream ends.
  std::string read_head();
  // Ends the connection with a reset, as a peer does that crashes.
  void vanish();
  // Ends both directions; a receive() in another thread returns. The only call that another thread may make.
  void shut_down();

 private:
  RawPeer() = default;
  void set_patience(int fd);

  int fd_ = -1;
  protocol::FrameReader reader_;
  std::vector<std::byte> input_;
  std::size_t used_ = 0;
};

// A listening socket on a free port of 127.0.0.1.
class Listener {
 public:
  Listener();
  ~Listener();
  Listener(const Listener&) = delete;
  Listener& operator=(const Listener&) = delete;
  std::uint16_t port() const { return port_; }
  std::unique_ptr<RawPeer> accept() const { return RawPeer::accept(fd_); }

 private:
  int fd_;
  std::uint16_t port_ = 0;
};

// One HTTP request with `Connection: close`; the whole answer.
std::string http(std::uint16_t port, const std::string& target, const std::string& method = "GET",
                 const std::string& headers = "");

}  // namespace incise::stream
