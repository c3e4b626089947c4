#include "server/stream/transport.hpp"

#include <boost/asio/as_tuple.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/websocket/error.hpp>
#include <vector>

namespace incise::stream {
namespace {

namespace beast = boost::beast;
using boost::system::error_code;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);
// Bytes read from one peer at a time. A simulator's messages are long: large reads take few turns for each, so that
// newer ones do not wait in the socket while the thread is busy.
constexpr std::size_t kSmallRead = 16 << 10, kLargeRead = 256 << 10;

std::string peer_of(NetStream::Tcp& tcp) {
  error_code ec;
  const auto endpoint = tcp.socket().remote_endpoint(ec);
  return ec ? "?" : name_of(endpoint);
}

class TcpTransport final : public Transport {
 public:
  explicit TcpTransport(NetStream stream) : stream_(std::move(stream)), peer_(peer_of(stream_.tcp())) {
    stream_.tcp().expires_never();
  }

  asio::awaitable<Received> read() override {
    for (;;) {
      const auto status = reader_.read(input_);
      if (status == protocol::FrameReader::Status::Complete) co_return Received::message(reader_.body());
      if (status == protocol::FrameReader::Status::Failed) co_return Received::bad(reader_.error(), true);
      if (buffer_.size() < read_bytes_) buffer_.resize(read_bytes_);
      const auto [ec, n] = co_await stream_.async_read_some(asio::buffer(buffer_), kTuple);
      if (ec) co_return Received::end(ec);
      input_ = std::span<const std::byte>(buffer_).first(n);
    }
  }

  void set_max_bytes(std::size_t max_bytes) override {
    reader_.set_max_bytes(max_bytes);
    if (max_bytes > protocol::kMaxClientBytes) read_bytes_ = kLargeRead;
  }

  void write(std::span<const SharedFrame> frames, std::function<void(error_code)> done) override {
    buffers_.clear();
    for (const SharedFrame& frame : frames) buffers_.emplace_back(frame->tcp().data(), frame->tcp().size());
    asio::async_write(stream_, buffers_, [done = std::move(done)](error_code ec, std::size_t) { done(ec); });
  }

  asio::awaitable<void> discard() override {
    for (;;) {
      const auto [ec, n] = co_await stream_.async_read_some(asio::buffer(buffer_), kTuple);
      if (ec) co_return;
    }
  }

  void shut_down(std::shared_ptr<void>) override { stream_.shut_down(asio::ip::tcp::socket::shutdown_send); }
  void close() override { stream_.close(); }
  std::string peer() const override { return peer_; }
  asio::any_io_executor executor() override { return stream_.get_executor(); }

 private:
  NetStream stream_;
  std::string peer_;
  protocol::FrameReader reader_{protocol::kMaxHandshakeBytes};
  std::size_t read_bytes_ = kSmallRead;
  std::vector<std::byte> buffer_ = std::vector<std::byte>(kSmallRead);
  std::span<const std::byte> input_;
  std::vector<asio::const_buffer> buffers_;
};

class WebSocketTransport final : public Transport {
 public:
  explicit WebSocketTransport(NetStream stream)
      : socket_(std::move(stream)), peer_(peer_of(socket_.stream().tcp())) {
    socket_.stream().tcp().expires_never();
    socket_.set_max_bytes(protocol::kMaxHandshakeBytes);
    // The peer has its own deadlines and pings.
    socket_.set_handshake_time(std::chrono::seconds(5));
  }

  asio::awaitable<bool> accept(const HttpRequest& request) {
    const error_code error = co_await socket_.accept(request, "incised");
    co_return !error;
  }

  asio::awaitable<Received> read() override {
    const error_code error = co_await socket_.read();
    if (error == beast::websocket::error::message_too_big ||
        error == beast::websocket::error::buffer_overflow) {
      co_return Received::bad("WebSocket message longer than accepted", true);
    }
    if (error) co_return Received::end(error);
    if (!socket_.got_binary())
      co_return Received::bad("WebSocket text frame; messages are binary frames", false);
    co_return Received::message(socket_.message());
  }

  void set_max_bytes(std::size_t max_bytes) override { socket_.set_max_bytes(max_bytes); }

  void write(std::span<const SharedFrame> frames, std::function<void(error_code)> done) override {
    write_next(frames, std::move(done), {});
  }

  asio::awaitable<void> discard() override {
    for (;;) {
      // In a variable: g++ 12 takes the wrong branch where the condition itself awaits.
      const error_code error = co_await socket_.read();
      if (error) co_return;
    }
  }

  void shut_down(std::shared_ptr<void> keep) override { socket_.say_goodbye(std::move(keep)); }
  void close() override { socket_.stream().close(); }
  std::string peer() const override { return peer_; }
  asio::any_io_executor executor() override { return socket_.stream().get_executor(); }

 private:
  void write_next(std::span<const SharedFrame> frames, std::function<void(error_code)> done, error_code ec) {
    if (ec || frames.empty()) return done(ec);
    socket_.write(frames.front()->body(),
                  [this, rest = frames.subspan(1), done = std::move(done)](error_code result) mutable {
                    write_next(rest, std::move(done), result);
                  });
  }

  net::WebSocket socket_;
  std::string peer_;
};

}  // namespace

std::string name_of(const asio::ip::tcp::endpoint& endpoint) {
  return endpoint.address().to_string() + ":" + std::to_string(endpoint.port());
}

std::unique_ptr<Transport> make_tcp_transport(NetStream stream) {
  return std::make_unique<TcpTransport>(std::move(stream));
}

asio::awaitable<std::unique_ptr<Transport>> accept_websocket(NetStream stream, const HttpRequest& request) {
  auto transport = std::make_unique<WebSocketTransport>(std::move(stream));
  const bool ok = co_await transport->accept(request);
  if (!ok) co_return nullptr;
  co_return transport;
}

}  // namespace incise::stream
