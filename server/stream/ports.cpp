#include "server/stream/ports.hpp"

#include <stdexcept>
#include <string>
#include <utility>

#include "protocol/net/listen_error.hpp"
#include "server/stream/tls.hpp"

namespace incise::stream {
namespace {

using asio::ip::tcp;

void check_safe(const StreamConfig& config, const asio::ip::address& address) {
  const bool tls = !config.certificate_file.empty();
  if (tls == config.private_key_file.empty()) {
    throw std::runtime_error(
        "listen: TLS needs both certificate_file and private_key_file, found only one of the two");
  }
  if (address.is_loopback() || config.insecure || (tls && !config.tokens.empty())) return;
  throw std::runtime_error("listen.address: " + config.address +
                           " is not loopback: give tokens and a TLS certificate, " +
                           "or set listen.insecure, which lets everybody on that network cut and watch");
}

std::runtime_error cannot_listen(const char* what, const tcp::endpoint& endpoint,
                                 const boost::system::system_error& error) {
  return net::cannot_listen(std::string("listen.") + what, endpoint.address().to_string(), endpoint.port(),
                            error.code());
}

tcp::acceptor bound(asio::io_context& io, const asio::ip::address& address, int port, const char* what) {
  if (port > 65535) {
    throw std::runtime_error(std::string("listen.") + what + ": " + std::to_string(port) +
                             ", accepted are -1 (off) to 65535");
  }
  const tcp::endpoint endpoint(address, static_cast<std::uint16_t>(port));
  try {
    tcp::acceptor acceptor(io);
    acceptor.open(endpoint.protocol());
    acceptor.set_option(tcp::acceptor::reuse_address(true));
    acceptor.bind(endpoint);
    return acceptor;
  } catch (const boost::system::system_error& error) {
    throw cannot_listen(what, endpoint, error);
  }
}

void listen_at(std::optional<tcp::acceptor>& acceptor, const char* what) {
  if (!acceptor) return;
  const tcp::endpoint endpoint = acceptor->local_endpoint();
  try {
    acceptor->listen(512);
  } catch (const boost::system::system_error& error) {
    throw cannot_listen(what, endpoint, error);
  }
}

}  // namespace

Ports::Ports(StreamConfig given) : config(std::move(given)) {
  boost::system::error_code error;
  const asio::ip::address address = asio::ip::make_address(config.address, error);
  if (error) {
    throw std::runtime_error("listen.address: \"" + config.address +
                             "\", accepted is an IP address such as 127.0.0.1");
  }
  check_safe(config, address);
  if (!config.certificate_file.empty()) {
    tls.emplace(asio::ssl::context::tls_server);
    load_certificate(*tls, config.certificate_file, config.private_key_file);
  }
  if (config.tcp_port >= 0) tcp_acceptor.emplace(bound(io, address, config.tcp_port, "tcp_port"));
  if (config.http_port >= 0) http_acceptor.emplace(bound(io, address, config.http_port, "http_port"));
}

void Ports::listen() {
  listen_at(tcp_acceptor, "tcp_port");
  listen_at(http_acceptor, "http_port");
}

}  // namespace incise::stream
