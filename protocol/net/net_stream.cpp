#include "protocol/net/net_stream.hpp"

#include <boost/asio/as_tuple.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/this_coro.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <chrono>
#include <memory>

namespace incise::net {
namespace {

using asio::ip::tcp;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);
constexpr std::chrono::seconds kTearDown{1};

// Reads until the other end has closed, or until the stream's deadline.
struct Drain {
  using executor_type = NetStream::executor_type;
  executor_type get_executor() const { return tcp->get_executor(); }

  void operator()(error_code error, std::size_t) {
    if (!error) {
      read();
      return;
    }
    error_code ignored;
    if (error != asio::error::operation_aborted) tcp->socket().close(ignored);
    done(error == asio::error::eof ? error_code() : error, 0);
  }
  void read() {
    const asio::mutable_buffer into = asio::buffer(*rest);
    tcp->async_read_some(into, std::move(*this));
  }

  NetStream::Tcp* tcp;
  IoHandler done;
  std::unique_ptr<std::array<char, 2048>> rest = std::make_unique<std::array<char, 2048>>();
};

}  // namespace

NetStream::NetStream(Tcp tcp) : plain_(std::move(tcp)) {}
NetStream::NetStream(Tcp tcp, asio::ssl::context& context)
    : secured_(std::in_place, std::move(tcp), context) {}
NetStream::NetStream(NetStream&& other) noexcept = default;
NetStream::~NetStream() = default;

asio::awaitable<error_code> NetStream::secure(asio::ssl::stream_base::handshake_type side) {
  const auto [error] = co_await secured_->async_handshake(side, kTuple);
  co_return error;
}

void NetStream::read_some(const Pieces<asio::mutable_buffer>& pieces, IoHandler handler) {
  if (secured_) {
    secured_->async_read_some(pieces, std::move(handler));
  } else {
    plain_->async_read_some(pieces, std::move(handler));
  }
}

void NetStream::write_some(const Pieces<asio::const_buffer>& pieces, IoHandler handler) {
  if (secured_) {
    secured_->async_write_some(pieces, std::move(handler));
  } else {
    plain_->async_write_some(pieces, std::move(handler));
  }
}

// Beast's own waits for the other end as long as that likes, which may be one that has just broken the rules.
void NetStream::tear_down(boost::beast::role_type role, IoHandler handler) {
  if (role == boost::beast::role_type::server) shut_down(tcp::socket::shutdown_send);
  tcp().expires_after(kTearDown);
  Drain{&tcp(), std::move(handler)}.read();
}

void NetStream::shut_down(tcp::socket::shutdown_type how) {
  error_code ignored;
  tcp().socket().shutdown(how, ignored);
}

void NetStream::close() {
  error_code ignored;
  tcp().socket().shutdown(tcp::socket::shutdown_both, ignored);
  tcp().socket().close(ignored);
}

asio::awaitable<error_code> connect(NetStream::Tcp& stream, std::string host, std::string service) {
  tcp::resolver resolver(stream.get_executor());
  const auto [resolve_error, found] = co_await resolver.async_resolve(host, service, kTuple);
  if (resolve_error) co_return resolve_error;
  const auto [error, endpoint] = co_await stream.async_connect(found, kTuple);
  if (error) co_return error;
  error_code ignored;
  stream.socket().set_option(tcp::no_delay(true), ignored);
  co_return error_code();
}

void beast_close_socket(NetStream& stream) {
  stream.close();
}

void teardown(boost::beast::role_type, NetStream& stream, error_code&) {
  stream.shut_down(tcp::socket::shutdown_both);
}

}  // namespace incise::net
