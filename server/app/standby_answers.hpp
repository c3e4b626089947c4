#pragma once

#include <boost/asio/awaitable.hpp>
#include <string>
#include <thread>

#include "server/stream/ports.hpp"

namespace incise::app {

// Answers at the HTTP port of an instance that stands by, so that what looks after it does not take it for dead: /healthz with 200, all else
// with 503. Nobody listens at the TCP port, which tells a load balancer that clients are not for here.
//
// Thread: one of its own. Owns: the listening socket, until it is destroyed.
class StandbyAnswers {
 public:
  // Throws std::runtime_error where it cannot listen.
  StandbyAnswers(stream::StreamConfig config, std::string session);
  ~StandbyAnswers();

 private:
  boost::asio::awaitable<void> accept();
  boost::asio::awaitable<void> serve(boost::asio::ip::tcp::socket socket);

  const std::string session_;
  stream::Ports ports_;
  int connections_ = 0;
  std::thread thread_;
};

}  // namespace incise::app
