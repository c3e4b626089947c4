#include "protocol/net/web_socket.hpp"

#include <boost/asio/as_tuple.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/websocket/stream.hpp>
#include <utility>

namespace incise::net {
namespace {

namespace beast = boost::beast;
namespace websocket = beast::websocket;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);

}  // namespace

struct WebSocket::Impl {
  explicit Impl(NetStream stream) : socket(std::move(stream)) {
    socket.binary(true);
    socket.auto_fragment(false);
  }
  websocket::stream<NetStream, false> socket;  // false: without compression
  beast::flat_buffer buffer;
};

WebSocket::WebSocket(NetStream stream) : impl_(std::make_unique<Impl>(std::move(stream))) {}
WebSocket::WebSocket(WebSocket&&) noexcept = default;
WebSocket::~WebSocket() = default;

NetStream& WebSocket::stream() {
  return impl_->socket.next_layer();
}

void WebSocket::send_text() {
  impl_->socket.text(true);
}

void WebSocket::set_max_bytes(std::size_t max_bytes) {
  impl_->socket.read_message_max(max_bytes);
}

void WebSocket::set_handshake_time(std::chrono::seconds time) {
  impl_->socket.set_option(websocket::stream_base::timeout{time, websocket::stream_base::none(), false});
}

asio::awaitable<error_code> WebSocket::accept(const HttpRequest& request, std::string server) {
  impl_->socket.set_option(
      websocket::stream_base::decorator([name = std::move(server)](websocket::response_type& response) {
        response.set(beast::http::field::server, name);
      }));
  const auto [error] = co_await impl_->socket.async_accept(request, kTuple);
  co_return error;
}

asio::awaitable<error_code> WebSocket::shake_hands(std::string host, std::string path) {
  const auto [error] = co_await impl_->socket.async_handshake(host, path, kTuple);
  co_return error;
}

asio::awaitable<error_code> WebSocket::read() {
  impl_->buffer.consume(impl_->buffer.size());
  const auto [error, bytes] = co_await impl_->socket.async_read(impl_->buffer, kTuple);
  co_return error;
}

std::span<const std::byte> WebSocket::message() const {
  const auto data = impl_->buffer.cdata();
  return {static_cast<const std::byte*>(data.data()), data.size()};
}

bool WebSocket::got_binary() const {
  return impl_->socket.got_binary();
}

asio::awaitable<error_code> WebSocket::write(std::span<const std::byte> message) {
  const auto [error, bytes] =
      co_await impl_->socket.async_write(asio::const_buffer(message.data(), message.size()), kTuple);
  co_return error;
}

void WebSocket::write(std::span<const std::byte> message, std::function<void(error_code)> done) {
  impl_->socket.async_write(asio::const_buffer(message.data(), message.size()),
                            [done = std::move(done)](error_code error, std::size_t) { done(error); });
}

void WebSocket::say_goodbye(std::shared_ptr<void> keep) {
  impl_->socket.async_close(websocket::close_code::normal, [keep = std::move(keep)](error_code) {});
}

}  // namespace incise::net
