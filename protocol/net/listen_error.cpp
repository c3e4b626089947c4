#include "protocol/net/listen_error.hpp"

#include <boost/asio/error.hpp>

namespace incise::net {

std::runtime_error cannot_listen(const std::string& key, const std::string& address, std::int64_t port,
                                 const boost::system::error_code& error) {
  std::string text =
      key + ": cannot listen on " + address + ":" + std::to_string(port) + ": " + error.message();
  if (error == boost::asio::error::address_in_use) {
    text += "; end the program that listens there (ss -ltnp shows it), or choose another " + key +
            " (0: any free one)";
  }
  return std::runtime_error(text);
}

}  // namespace incise::net
