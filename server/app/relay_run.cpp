#include "server/app/relay_run.hpp"

#include <spdlog/spdlog.h>

#include <atomic>
#include <cstdio>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <vector>

#include "client/cli/commands.hpp"
#include "server/app/audit_log.hpp"
#include "server/app/end_signals.hpp"
#include "server/app/relay_report.hpp"
#include "server/app/stream_setup.hpp"
#include "server/relay/tcp_upstream.hpp"

namespace incise::app {
namespace {

relay::Origin origin_of(const Config& config, const Config::Relay::Session& session) {
  client::ServerOptions server;
  server.address = session.upstream;
  server.token_file = config.resolve(config.relay.token_file);
  server.ca_file = config.resolve(config.relay.ca_file);
  client::Address where;
  relay::Origin origin;
  origin.options = server.options(where);
  origin.host = where.host;
  origin.tcp_port = where.port;
  const bool web = where.transport == client::TransportKind::kWebSocket;
  origin.http_port = web ? where.port : static_cast<std::uint16_t>(session.upstream_http_port);
  return origin;
}

// All sessions of a relay.
class RunningRelay {
 public:
  explicit RunningRelay(const Config& config);
  void start();
  // Until a signal comes, or a session cannot listen.
  void watch(const EndSignals& signals);
  void stop();

 private:
  relay::Session::Reports reports(const relay::Session& session);
  void print_places(const relay::Session& session, std::uint16_t tcp_port, std::uint16_t http_port);

  const Config& config_;
  AuditLog audit_;
  std::vector<std::unique_ptr<relay::Session>> sessions_;
  std::mutex mutex_;
  std::string failure_;  // guarded by mutex_
};

RunningRelay::RunningRelay(const Config& config) : config_(config) {
  for (const Config::Relay::Session& session : config.relay.all(config.listen)) {
    stream::StreamConfig served = stream_config(config);
    served.tcp_port = static_cast<int>(session.tcp_port);
    served.http_port = static_cast<int>(session.http_port);
    const relay::Origin origin = origin_of(config, session);
    sessions_.push_back(
        std::make_unique<relay::Session>(session.name, std::move(served), [&](boost::asio::io_context& io) {
          return std::make_unique<relay::TcpUpstream>(io, origin, session.upstream);
        }));
  }
}

void RunningRelay::start() {
  for (const auto& session : sessions_) session->start(reports(*session));
}

relay::Session::Reports RunningRelay::reports(const relay::Session& session) {
  relay::Session::Reports reports;
  reports.stats_json = [&session] { return relay_stats_json(session); };
  reports.metrics_text = [&session] { return relay_metrics(session); };
  reports.audit = [this](auto kind, auto& address, auto& line) { audit_.write(kind, address, line); };
  reports.on_listening = [this, &session](std::uint16_t tcp, std::uint16_t http) {
    print_places(session, tcp, http);
  };
  reports.on_failed = [this](const std::string& why) {
    const std::scoped_lock lock(mutex_);
    failure_ = why;
  };
  return reports;
}

// One line on stdout for each session, for people and for scripts that wait for it; all else goes to the log.
void RunningRelay::print_places(const relay::Session& session, std::uint16_t tcp_port,
                                std::uint16_t http_port) {
  const auto place = [&](std::uint16_t port) {
    return port == 0 ? std::string("off") : config_.listen.address + ":" + std::to_string(port);
  };
  const std::scoped_lock lock(mutex_);
  std::printf("listening tcp=%s http=%s session=%s\n", place(tcp_port).c_str(), place(http_port).c_str(),
              session.name().c_str());
  std::fflush(stdout);
}

void RunningRelay::watch(const EndSignals& signals) {
  for (;;) {
    if (const char* const signal = signals.wait()) {
      spdlog::info("{}: ending", signal);
      return;
    }
    audit_.flush();
    const std::scoped_lock lock(mutex_);
    if (!failure_.empty()) throw std::runtime_error(failure_);
  }
}

void RunningRelay::stop() {
  for (const auto& session : sessions_) session->stop();
}

}  // namespace

void run_relay(const Config& config) {
  const EndSignals signals;
  RunningRelay relay(config);
  relay.start();
  relay.watch(signals);
  relay.stop();
}

}  // namespace incise::app
