#pragma once

#include <boost/asio/awaitable.hpp>
#include <boost/beast/http/message.hpp>
#include <boost/beast/http/string_body.hpp>
#include <chrono>
#include <cstddef>
#include <functional>
#include <memory>
#include <span>
#include <string>

#include "protocol/net/net_stream.hpp"

namespace incise::net {

using HttpRequest = boost::beast::http::request<boost::beast::http::string_body>;

// A WebSocket, compiled once for server and clients. Sends binary messages, or text ones. No message is compressed.
//
// Thread: the stream's. Owns: the stream.
class WebSocket {
 public:
  explicit WebSocket(NetStream stream);
  WebSocket(WebSocket&&) noexcept;
  ~WebSocket();

  NetStream& stream();
  void send_text();
  void set_max_bytes(std::size_t max_bytes);
  // How long the handshakes at the beginning and the end may take; without a call as long as the stream's deadline says.
  void set_handshake_time(std::chrono::seconds time);

  // The server's side: answers the upgrade request as a server of that name.
  asio::awaitable<error_code> accept(const HttpRequest& request, std::string server);
  // The client's side; `host` is what the header Host says.
  asio::awaitable<error_code> shake_hands(std::string host, std::string path);

  // Waits for the next message.
  asio::awaitable<error_code> read();
  // The last one; valid until the next read.
  std::span<const std::byte> message() const;
  bool got_binary() const;

  // Writes one message, whose bytes must stay until then; one at a time.
  asio::awaitable<error_code> write(std::span<const std::byte> message);
  // Calls `done`, never from within.
  void write(std::span<const std::byte> message, std::function<void(error_code)> done);
  // The closing handshake; `keep` stays until it is over.
  void say_goodbye(std::shared_ptr<void> keep);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace incise::net
