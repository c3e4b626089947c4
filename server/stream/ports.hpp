#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl/context.hpp>
#include <optional>

#include "server/stream/stream_config.hpp"

namespace incise::stream {

namespace asio = boost::asio;

// What a server needs of the machine, taken before anything else: its ports, and its TLS certificate. A start that cannot have
// them fails here, and has changed nothing. Until listen() clients are refused, as if nobody were there.
//
// Thread: the one that makes the server; then the stream's.
struct Ports {
  // Throws std::runtime_error where a port is in use, or the configuration is not safe.
  explicit Ports(StreamConfig config);
  void listen();

  const StreamConfig config;
  asio::io_context io{1};
  std::optional<asio::ssl::context> tls;
  std::optional<asio::ip::tcp::acceptor> tcp_acceptor, http_acceptor;
};

}  // namespace incise::stream
