#include "client/link.hpp"

#include <array>
#include <boost/asio/as_tuple.hpp>
#include <boost/asio/connect.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl.hpp>
#include <boost/asio/this_coro.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/ssl.hpp>
#include <boost/beast/websocket.hpp>
#include <boost/beast/websocket/ssl.hpp>

namespace incise::client {
namespace {

namespace beast = boost::beast;
namespace ssl = asio::ssl;
namespace websocket = beast::websocket;
using asio::ip::tcp;
using boost::system::error_code;
using TcpStream = beast::tcp_stream;
using TlsStream = ssl::stream<TcpStream>;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);

// Keeps what a TLS stream refers to.
struct TlsContext {
  ssl::context context{ssl::context::tls_client};
};

template <class Stream>
class TcpLink final : public Link {
 public:
  TcpLink(Stream stream, std::shared_ptr<TlsContext> tls)
      : tls_(std::move(tls)), stream_(std::move(stream)) {}

  asio::awaitable<Received> read() override {
    for (;;) {
      const auto status = reader_.read(input_);
      if (status == protocol::FrameReader::Status::Complete) co_return Received::message(reader_.body());
      if (status == protocol::FrameReader::Status::Failed) co_return Received::end(reader_.error());
      const auto [ec, n] = co_await stream_.async_read_some(asio::buffer(buffer_), kTuple);
      if (ec) co_return Received::end(ec.message());
      input_ = std::span<const std::byte>(buffer_).first(n);
    }
  }

  asio::awaitable<error_code> write(const protocol::Frame& frame) override {
    const auto bytes = frame.tcp();
    const auto [ec, n] =
        co_await asio::async_write(stream_, asio::buffer(bytes.data(), bytes.size()), kTuple);
    co_return ec;
  }

  void close() override {
    error_code ignored;
    auto& socket = beast::get_lowest_layer(stream_).socket();
    socket.shutdown(tcp::socket::shutdown_both, ignored);
    socket.close(ignored);
  }

 private:
  std::shared_ptr<TlsContext> tls_;
  Stream stream_;
  protocol::FrameReader reader_;
  std::array<std::byte, 65536> buffer_;
  std::span<const std::byte> input_;
};

template <class Stream>
class WebSocketLink final : public Link {
 public:
  WebSocketLink(Stream stream, std::shared_ptr<TlsContext> tls)
      : tls_(std::move(tls)), stream_(std::move(stream)) {
    stream_.binary(true);
    stream_.auto_fragment(false);
    stream_.read_message_max(protocol::kMaxMessageBytes);
  }

  asio::awaitable<error_code> shake_hands(std::string host) {
    const auto [ec] = co_await stream_.async_handshake(host, "/ws", kTuple);
    co_return ec;
  }
  void expires_never() {
    beast::get_lowest_layer(stream_).expires_never();
    stream_.set_option(websocket::stream_base::timeout{websocket::stream_base::none(),
                                                       websocket::stream_base::none(), false});
  }

  asio::awaitable<Received> read() override {
    buffer_.consume(buffer_.size());
    const auto [ec, n] = co_await stream_.async_read(buffer_, kTuple);
    if (ec) co_return Received::end(ec.message());
    const auto data = buffer_.cdata();
    co_return Received::message({static_cast<const std::byte*>(data.data()), data.size()});
  }

  asio::awaitable<error_code> write(const protocol::Frame& frame) override {
    const auto bytes = frame.body();
    const auto [ec, n] = co_await stream_.async_write(asio::buffer(bytes.data(), bytes.size()), kTuple);
    co_return ec;
  }

  void close() override {
    error_code ignored;
    auto& socket = beast::get_lowest_layer(stream_).socket();
    socket.shutdown(tcp::socket::shutdown_both, ignored);
    socket.close(ignored);
  }

 private:
  std::shared_ptr<TlsContext> tls_;
  websocket::stream<Stream> stream_;
  beast::flat_buffer buffer_;
};

[[noreturn]] void fail(const std::string& host, std::uint16_t port, const std::string& what) {
  throw ConnectError(host + ":" + std::to_string(port) + ": " + what);
}

template <class Stream>
asio::awaitable<std::unique_ptr<Link>> finish(Stream stream, std::shared_ptr<TlsContext> tls,
                                              const std::string& host, std::uint16_t port,
                                              TransportKind kind) {
  if (kind == TransportKind::kTcp) {
    beast::get_lowest_layer(stream).expires_never();
    co_return std::make_unique<TcpLink<Stream>>(std::move(stream), std::move(tls));
  }
  const bool tls_used = tls != nullptr;
  auto link = std::make_unique<WebSocketLink<Stream>>(std::move(stream), std::move(tls));
  const bool literal_v6 = host.find(':') != std::string::npos;
  const std::string name = (literal_v6 ? "[" + host + "]" : host) + ":" + std::to_string(port);
  const error_code ec = co_await link->shake_hands(name);
  if (ec) {
    const bool silent = ec == beast::http::error::end_of_stream || ec == asio::error::eof;
    fail(host, port, "no WebSocket there: " + (silent && !tls_used ? std::string(kMaybeTls) : ec.message()));
  }
  link->expires_never();
  co_return link;
}

std::shared_ptr<TlsContext> make_tls(const std::string& host, std::uint16_t port, const Options& options) {
  auto tls = std::make_shared<TlsContext>();
  tls->context.set_verify_mode(ssl::verify_peer);
  error_code ec;
  if (options.ca_file.empty()) {
    tls->context.set_default_verify_paths(ec);
  } else {
    tls->context.load_verify_file(options.ca_file, ec);
  }
  if (ec) fail(host, port, "certificates " + options.ca_file + ": " + ec.message());
  return tls;
}

// Why no TLS came about, and what to look at.
std::string tls_failure(const error_code& ec, SSL* connection, const std::string& host) {
  const long verdict = SSL_get_verify_result(connection);
  if (verdict != X509_V_OK) {
    return std::string("TLS: the server's certificate is not trusted: ") +
           X509_verify_cert_error_string(verdict) + "; give the file of the authority that signed it (--ca)";
  }
  std::string what = "TLS: " + ec.message();
  if (what.find("certificate verify failed") != std::string::npos)
    return what + ": the certificate is not for the name " + host;
  if (what.find("wrong version number") != std::string::npos) return what + ": no TLS is spoken there";
  return what;
}

}  // namespace

asio::awaitable<std::unique_ptr<Link>> open_link(std::string host, std::uint16_t port, const Options& options,
                                                 std::chrono::steady_clock::time_point deadline) {
  const auto executor = co_await asio::this_coro::executor;
  tcp::resolver resolver(executor);
  const auto [resolve_error, endpoints] = co_await resolver.async_resolve(host, std::to_string(port), kTuple);
  if (resolve_error) fail(host, port, resolve_error.message());
  TcpStream stream(executor);
  stream.expires_at(deadline);
  const auto [connect_error, endpoint] = co_await stream.async_connect(endpoints, kTuple);
  if (connect_error) fail(host, port, connect_error.message());
  error_code ignored;
  stream.socket().set_option(tcp::no_delay(true), ignored);
  if (!options.tls) co_return co_await finish(std::move(stream), nullptr, host, port, options.transport);

  auto tls = make_tls(host, port, options);
  TlsStream secured(std::move(stream), tls->context);
  SSL_set_tlsext_host_name(secured.native_handle(), host.c_str());
  secured.set_verify_callback(ssl::host_name_verification(host));
  const auto [tls_error] = co_await secured.async_handshake(ssl::stream_base::client, kTuple);
  if (tls_error) fail(host, port, tls_failure(tls_error, secured.native_handle(), host));
  co_return co_await finish(std::move(secured), std::move(tls), host, port, options.transport);
}

}  // namespace incise::client
