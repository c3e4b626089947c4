#include "server/app/relay_run.hpp"

#include <spdlog/spdlog.h>

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <vector>

#include "client/cli/commands.hpp"
#include "server/app/advertised.hpp"
#include "server/app/audit_log.hpp"
#include "server/app/end_signals.hpp"
#include "server/app/log_setup.hpp"
#include "server/app/nats_options.hpp"
#include "server/app/nats_upstream.hpp"
#include "server/app/relay_report.hpp"
#include "server/app/stream_setup.hpp"
#include "server/app/version.hpp"
#include "server/base/clock.hpp"
#include "server/base/hex.hpp"
#include "server/cluster/directory.hpp"
#include "server/cluster/session_subjects.hpp"
#include "server/relay/tcp_upstream.hpp"

namespace incise::app {
namespace {

// What answers at `address`, but for its HTTP port.
relay::Origin origin_at(const Config& config, const std::string& address) {
  client::ServerOptions server;
  server.address = address;
  server.token_file = config.resolve(config.relay.token_file);
  server.ca_file = config.resolve(config.relay.ca_file);
  client::Address where;
  relay::Origin origin;
  origin.options = server.options(where);
  origin.host = where.host;
  origin.tcp_port = where.port;
  return origin;
}

relay::Origin origin_of(const Config& config, const Config::Relay::Session& session) {
  relay::Origin origin = origin_at(config, session.upstream);
  const bool web = origin.options.transport == client::TransportKind::kWebSocket;
  origin.http_port = web ? origin.tcp_port : static_cast<std::uint16_t>(session.upstream_http_port);
  if (!web) origin.http_option = "--upstream-http-port (relay.upstream_http_port)";
  return origin;
}

// The server that publishes a session, by the directory.
std::optional<relay::Origin> listed_origin(const Config& config, const cluster::Directory& directory,
                                           const std::string& session) {
  for (const cluster::DirectoryEntry& entry : directory.entries()) {
    if (entry.session != session || entry.kind != "server" || entry.tcp.empty()) continue;
    relay::Origin origin = origin_at(config, entry.tcp);
    const std::size_t colon = entry.http.rfind(':');
    if (colon != std::string::npos)
      origin.http_port = static_cast<std::uint16_t>(std::atoi(entry.http.c_str() + colon + 1));
    return origin;
  }
  return std::nullopt;
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

  std::vector<cluster::DirectoryEntry> entries();

  // What the directory shows of a session.
  struct Listed {
    std::string name;
    std::uint16_t tcp = 0, http = 0;
  };
  const Config& config_;
  const std::int64_t started_unix_ns_ = unix_ns();
  const std::string instance_ = hex(fresh_session_id());
  AuditLog audit_;
  std::unique_ptr<cluster::Directory> directory_;  // null without NATS
  std::vector<Listed> listed_;                     // guarded by mutex_; one for each of sessions_
  std::vector<std::unique_ptr<relay::Session>> sessions_;
  std::mutex mutex_;
  std::string failure_;  // guarded by mutex_
};

RunningRelay::RunningRelay(const Config& config) : config_(config) {
  if (!config.cluster.nats.empty())
    directory_ = std::make_unique<cluster::Directory>(nats_options(config), log_line);
  for (const Config::Relay::Session& session : config.relay.all(config.listen)) {
    stream::StreamConfig served = stream_config(config);
    served.tcp_port = static_cast<int>(session.tcp_port);
    served.http_port = static_cast<int>(session.http_port);
    const std::string published = session.nats_session();
    const auto make = [&](boost::asio::io_context& io) -> std::unique_ptr<relay::Upstream> {
      if (published.empty())
        return std::make_unique<relay::TcpUpstream>(io, origin_of(config, session), session.upstream);
      return std::make_unique<NatsUpstream>(io, nats_options(config), published, [this, published] {
        return listed_origin(config_, *directory_, published);
      });
    };
    sessions_.push_back(std::make_unique<relay::Session>(session.name, std::move(served), make));
    listed_.push_back({published.empty() ? session.name : published});
  }
}

void RunningRelay::start() {
  for (const auto& session : sessions_) session->start(reports(*session));
  if (!directory_) return;
  directory_->start([this] { return entries(); });
}

// Of the sessions that have come.
std::vector<cluster::DirectoryEntry> RunningRelay::entries() {
  std::vector<cluster::DirectoryEntry> entries;
  for (std::size_t i = 0; i < sessions_.size(); ++i) {
    const relay::Session& session = *sessions_[i];
    const std::scoped_lock lock(mutex_);
    const Listed& listed = listed_[i];
    if ((listed.tcp == 0 && listed.http == 0) || !cluster::is_session_name(listed.name)) continue;
    cluster::DirectoryEntry entry;
    entry.session = listed.name;
    entry.kind = "relay";
    entry.instance = instance_ + "-" + std::to_string(i);
    entry.body = session.figures().body;
    entry.tcp = advertised(config_, listed.tcp, false);
    entry.http = advertised(config_, listed.http, true);
    entry.software = kSoftware;
    const stream::StreamCounters counters = session.counters();
    entry.revision = counters.revision;
    entry.viewers = static_cast<std::uint32_t>(counters.peers);
    entry.started_unix_s = started_unix_ns_ / 1'000'000'000;
    entries.push_back(std::move(entry));
  }
  return entries;
}

relay::Session::Reports RunningRelay::reports(const relay::Session& session) {
  relay::Session::Reports reports;
  reports.stats_json = [&session] { return relay_stats_json(session); };
  reports.metrics_text = [&session] { return relay_metrics(session); };
  reports.audit = [this](auto kind, auto& address, auto& line) { audit_.write(kind, address, line); };
  if (directory_) reports.sessions_json = [this] { return directory_->json(); };
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
  for (std::size_t i = 0; i < sessions_.size(); ++i) {
    if (sessions_[i].get() == &session) listed_[i].tcp = tcp_port, listed_[i].http = http_port;
  }
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
  if (directory_) directory_->stop();
  for (const auto& session : sessions_) session->stop();
}

}  // namespace

void run_relay(const Config& config, const EndSignals& signals) {
  raise_descriptor_limit();
  RunningRelay relay(config);
  relay.start();
  relay.watch(signals);
  relay.stop();
}

}  // namespace incise::app
