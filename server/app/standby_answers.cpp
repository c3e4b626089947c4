#include "server/app/standby_answers.hpp"

#include <boost/asio/as_tuple.hpp>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/string_body.hpp>
#include <boost/beast/http/write.hpp>
#include <chrono>
#include <exception>
#include <utility>

#include "protocol/net/net_stream.hpp"
#include "server/base/thread_name.hpp"
#include "server/stream/pause.hpp"

namespace incise::app {
namespace {

namespace asio = boost::asio;
namespace http = boost::beast::http;
constexpr auto kTuple = asio::as_tuple(asio::use_awaitable);
constexpr std::chrono::seconds kRequestTime{5};
constexpr std::uint32_t kMaxRequestBytes = 8192;
constexpr int kMaxConnections = 16;  // of probes

stream::StreamConfig without_tcp(stream::StreamConfig config) {
  config.tcp_port = -1;
  return config;
}

}  // namespace

StandbyAnswers::StandbyAnswers(stream::StreamConfig config, std::string session)
    : session_(std::move(session)), ports_(without_tcp(std::move(config))) {
  ports_.listen();
  asio::co_spawn(ports_.io, accept(), [](std::exception_ptr) {});
  thread_ = std::thread([this] {
    name_thread("standby");
    ports_.io.run();
  });
}

StandbyAnswers::~StandbyAnswers() {
  ports_.io.stop();
  thread_.join();
}

asio::awaitable<void> StandbyAnswers::accept() {
  for (;;) {
    auto [error, socket] = co_await ports_.http_acceptor->async_accept(kTuple);
    if (error) {
      co_await stream::pause(std::chrono::milliseconds(100));  // out of descriptors, most likely
      continue;
    }
    if (connections_ == kMaxConnections) continue;  // the socket closes here
    ++connections_;
    asio::co_spawn(ports_.io, serve(std::move(socket)), [this](std::exception_ptr) { --connections_; });
  }
}

asio::awaitable<void> StandbyAnswers::serve(asio::ip::tcp::socket socket) {
  net::NetStream::Tcp tcp(std::move(socket));
  net::NetStream stream =
      ports_.tls ? net::NetStream(std::move(tcp), *ports_.tls) : net::NetStream(std::move(tcp));
  stream.tcp().expires_after(kRequestTime);
  if (ports_.tls && co_await stream.secure(asio::ssl::stream_base::server)) co_return;
  boost::beast::flat_buffer buffer;
  http::request_parser<http::string_body> parser;
  parser.header_limit(kMaxRequestBytes);
  parser.body_limit(kMaxRequestBytes);
  const auto [error, bytes] = co_await http::async_read(stream, buffer, parser, kTuple);
  if (error) co_return;
  const auto& request = parser.get();
  const bool health = request.target() == "/healthz";
  http::response<http::string_body> response(health ? http::status::ok : http::status::service_unavailable,
                                             request.version());
  response.set(http::field::content_type, "application/json");
  response.set(http::field::cache_control, "no-store");
  response.keep_alive(false);
  response.body() = "{\"status\":\"standing by: another instance has session " + session_ + "\"}\n";
  response.prepare_payload();
  if (request.method() == http::verb::head) response.body().clear();
  co_await http::async_write(stream, response, kTuple);
}

}  // namespace incise::app
