#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <memory>
#include <string>

#include "server/relay/connection.hpp"
#include "server/relay/upstream.hpp"

namespace incise::relay {

// An incised, or another relay, of which the relay is one viewer. Connects again for as long as it takes.
//
// Thread: the io_context's.
class TcpUpstream final : public Upstream, private Connection::Owner {
 public:
  // `name`: for people.
  TcpUpstream(asio::io_context& io, Origin server, std::string name);
  ~TcpUpstream() override;

  void start(Sink& sink) override;
  void stop() override;
  void resync(const std::string& reason) override;
  void leave(const std::string& why) override;
  std::optional<Origin> origin() const override { return server_; }
  std::string name() const override { return name_; }
  std::chrono::nanoseconds round_trip() const override;

 private:
  void connect();
  void on_message(const protocol::Message& message) override;
  void on_end(const Connection::End& end, bool welcomed) override;

  asio::io_context& io_;
  const Origin server_;
  const std::string name_;
  Sink* sink_ = nullptr;  // null: stopped
  std::shared_ptr<Connection> connection_;
  asio::steady_timer retry_;
  std::chrono::milliseconds pause_;
  std::int64_t welcomed_ns_ = 0, resynced_ns_ = 0;
  std::int64_t ahead_ns_ = 0;  // by Welcome, until a ping is answered
};

}  // namespace incise::relay
