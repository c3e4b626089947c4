#pragma once

#include <boost/asio/ssl/stream.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/ssl.hpp>
#include <boost/beast/websocket/teardown.hpp>
#include <optional>
#include <utility>

namespace incise::stream {

namespace asio = boost::asio;

// A TCP connection, with TLS or without: one type, so that all that is written for streams is compiled once.
//
// Thread: the stream thread. Owns: the socket.
class NetStream {
 public:
  using Tcp = boost::beast::tcp_stream;
  using executor_type = Tcp::executor_type;

  explicit NetStream(Tcp tcp) : plain_(std::move(tcp)) {}
  NetStream(Tcp tcp, asio::ssl::context& context) : secured_(std::in_place, std::move(tcp), context) {}
  NetStream(NetStream&&) = default;

  executor_type get_executor() { return tcp().get_executor(); }
  Tcp& tcp() { return secured_ ? secured_->next_layer() : *plain_; }
  // The TLS layer, or null.
  boost::beast::ssl_stream<Tcp>* tls() { return secured_ ? &*secured_ : nullptr; }

  template <class Buffers, class Token>
  auto async_read_some(const Buffers& buffers, Token&& token) {
    if (secured_) return secured_->async_read_some(buffers, std::forward<Token>(token));
    return plain_->async_read_some(buffers, std::forward<Token>(token));
  }
  template <class Buffers, class Token>
  auto async_write_some(const Buffers& buffers, Token&& token) {
    if (secured_) return secured_->async_write_some(buffers, std::forward<Token>(token));
    return plain_->async_write_some(buffers, std::forward<Token>(token));
  }

  void shut_down(asio::ip::tcp::socket::shutdown_type how) {
    boost::system::error_code ignored;
    tcp().socket().shutdown(how, ignored);
  }
  void close() {
    boost::system::error_code ignored;
    tcp().socket().shutdown(asio::ip::tcp::socket::shutdown_both, ignored);
    tcp().socket().close(ignored);
  }

 private:
  std::optional<Tcp> plain_;  // one of the two
  std::optional<boost::beast::ssl_stream<Tcp>> secured_;
};

// How Beast ends a connection at once; found by argument-dependent lookup.
inline void beast_close_socket(NetStream& stream) {
  stream.close();
}

// What a WebSocket does at its end: the closing of TLS tells nothing that its own closing has not told.
inline void teardown(boost::beast::role_type, NetStream& stream, boost::system::error_code&) {
  stream.shut_down(asio::ip::tcp::socket::shutdown_both);
}
template <class Handler>
void async_teardown(boost::beast::role_type role, NetStream& stream, Handler&& handler) {
  boost::beast::websocket::async_teardown(role, stream.tcp().socket(), std::forward<Handler>(handler));
}

}  // namespace incise::stream
