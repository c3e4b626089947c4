#pragma once

#include <array>
#include <boost/asio/async_result.hpp>
#include <boost/asio/awaitable.hpp>
#include <boost/asio/buffer.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/beast/core/role.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/ssl/ssl_stream.hpp>
#include <cstddef>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>

#include "protocol/net/io_handler.hpp"

// Else there are two copies of Beast's error categories in a program, and what compares them goes wrong: requests of more than 512 bytes got 400.
#if !defined(BOOST_ASIO_SEPARATE_COMPILATION) || !defined(BOOST_BEAST_SEPARATE_COMPILATION)
#error "link to incise_net, which Asio and Beast are compiled into"
#endif

namespace incise::net {

// The first buffers of a sequence, of one type whatever the sequence's is. Reads and writes of "some" may stop there.
template <class Buffer>
class Pieces {
 public:
  template <class Buffers>
  explicit Pieces(const Buffers& buffers) {
    const auto end = asio::buffer_sequence_end(buffers);
    for (auto at = asio::buffer_sequence_begin(buffers); at != end && size_ < pieces_.size(); ++at) {
      const Buffer piece(*at);
      if (piece.size() > 0) pieces_[size_++] = piece;
    }
  }
  const Buffer* begin() const { return pieces_.data(); }
  const Buffer* end() const { return pieces_.data() + size_; }

 private:
  std::array<Buffer, 16> pieces_;
  std::size_t size_ = 0;
};

// A TCP connection, with TLS or without: one type, so that all that is written for streams is compiled once.
//
// Thread: its executor's. Owns: the socket.
class NetStream {
 public:
  using Tcp = boost::beast::tcp_stream;
  using Tls = boost::beast::ssl_stream<Tcp>;
  using executor_type = Tcp::executor_type;

  explicit NetStream(Tcp tcp);
  NetStream(Tcp tcp, asio::ssl::context& context);
  NetStream(NetStream&& other) noexcept;
  ~NetStream();

  executor_type get_executor() { return tcp().get_executor(); }
  Tcp& tcp() { return secured_ ? secured_->next_layer() : *plain_; }
  // The TLS layer, or null.
  Tls* tls() { return secured_ ? &*secured_ : nullptr; }
  // TLS's handshake.
  asio::awaitable<error_code> secure(asio::ssl::stream_base::handshake_type side);

  template <class Buffers, class Token>
  auto async_read_some(const Buffers& buffers, Token&& token) {
    const auto start = [this](auto&& handler, const Pieces<asio::mutable_buffer>& pieces) {
      read_some(pieces, hide(std::forward<decltype(handler)>(handler)));
    };
    return asio::async_initiate<Token, void(error_code, std::size_t)>(start, token,
                                                                      Pieces<asio::mutable_buffer>(buffers));
  }
  template <class Buffers, class Token>
  auto async_write_some(const Buffers& buffers, Token&& token) {
    const auto start = [this](auto&& handler, const Pieces<asio::const_buffer>& pieces) {
      write_some(pieces, hide(std::forward<decltype(handler)>(handler)));
    };
    return asio::async_initiate<Token, void(error_code, std::size_t)>(start, token,
                                                                      Pieces<asio::const_buffer>(buffers));
  }
  // What a WebSocket does at its end.
  template <class Handler>
  void async_tear_down(boost::beast::role_type role, Handler&& handler) {
    tear_down(role, hide(std::forward<Handler>(handler)));
  }

  void shut_down(asio::ip::tcp::socket::shutdown_type how);
  void close();

 private:
  template <class Handler>
  IoHandler hide(Handler&& handler) {
    return IoHandler(std::decay_t<Handler>(std::forward<Handler>(handler)), get_executor());
  }
  void read_some(const Pieces<asio::mutable_buffer>& pieces, IoHandler handler);
  void write_some(const Pieces<asio::const_buffer>& pieces, IoHandler handler);
  void tear_down(boost::beast::role_type role, IoHandler handler);

  std::optional<Tcp> plain_;  // one of the two
  std::optional<Tls> secured_;
};

// Resolves the name and connects, by the deadline that the stream has.
asio::awaitable<error_code> connect(NetStream::Tcp& tcp, std::string host, std::string service);

// How Beast ends a connection at once; found by argument-dependent lookup.
void beast_close_socket(NetStream& stream);
// What a WebSocket does at its end: the closing of TLS tells nothing that its own closing has not told.
void teardown(boost::beast::role_type role, NetStream& stream, error_code& error);
template <class Handler>
void async_teardown(boost::beast::role_type role, NetStream& stream, Handler&& handler) {
  stream.async_tear_down(role, std::forward<Handler>(handler));
}

}  // namespace incise::net
