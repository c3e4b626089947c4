// incise-relay: serves a session that another server cuts. Start-up faults end it with one line that says what to do.

#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>

#include "client/cli/usage.hpp"
#include "server/app/certificate_check.hpp"
#include "server/app/check_option.hpp"
#include "server/app/config.hpp"
#include "server/app/end_signals.hpp"
#include "server/app/freed_memory.hpp"
#include "server/app/log_setup.hpp"
#include "server/app/manual.hpp"
#include "server/app/relay_run.hpp"
#include "server/app/version.hpp"
#include "server/base/clock.hpp"
#include "server/base/standard_output.hpp"
#include "server/cluster/session_subjects.hpp"

namespace {

using incise::app::Config;
using incise::app::Program;

// What the command line gives instead of a configuration, or beside it.
struct Given {
  std::string to, nats, session, credentials_file, token_file, ca_file;
  int port = -2, http_port = -2, upstream_http_port = -2;  // -2: not given
};

void override_with(const Given& given, Config& config) {
  // A path on the command line is relative to the working directory.
  const auto path = [](const std::string& text) { return std::filesystem::absolute(text).string(); };
  if (!given.to.empty()) {
    config.relay.upstream = given.to;
    config.relay.sessions.clear();
  }
  if (!given.nats.empty()) config.cluster.nats = given.nats;
  if (!given.credentials_file.empty()) config.cluster.credentials_file = path(given.credentials_file);
  if (!given.session.empty()) {
    if (!incise::cluster::is_session_name(given.session)) {
      throw incise::client::UsageError("--session " + given.session +
                                       ": accepted are 1 to 64 letters, digits, \"-\" and \"_\"");
    }
    config.relay.upstream = "nats:" + given.session;
    config.relay.sessions.clear();
  }
  if (!given.token_file.empty()) config.relay.token_file = path(given.token_file);
  if (!given.ca_file.empty()) config.relay.ca_file = config.cluster.ca_file = path(given.ca_file);
  if (given.port != -2) config.listen.tcp_port = given.port;
  if (given.http_port != -2) config.listen.http_port = given.http_port;
  if (given.upstream_http_port != -2) config.relay.upstream_http_port = given.upstream_http_port;
}

int run(int argc, char** argv) {
  CLI::App app(
      "A relay: follows a cut server, or another relay, and serves its session to any number of viewers "
      "as that server would. Operators here hold blades there.",
      "incise-relay");
  app.set_version_flag("--version", incise::app::kSoftware);
  app.footer("Exit status: " + incise::app::exit_statuses(8));
  std::string config_file, check_file;
  bool print_config = false;
  Given given;
  app.add_option("--config", config_file, "Run with this configuration");
  app.add_option("--to", given.to,
                 "Follow this server: [tcp://|tls://|ws://|wss://]HOST[:PORT]; without a port 7450, or 7480 "
                 "for ws and wss");
  app.add_option("--nats", given.nats,
                 "nats://HOST[:PORT] or tls://HOST[:PORT]: list the relay there, and with --session follow "
                 "that session");
  CLI::Option* session =
      app.add_option("--session", given.session, "Follow what is published by that name on --nats");
  session->excludes("--to");
  app.add_option("--credentials", given.credentials_file, "Who we are on NATS, as cluster.credentials_file");
  app.add_option("--port", given.port, "Port of the binary protocol; 0: any free one, -1: off")
      ->check(CLI::Range(-1, 65535));
  app.add_option("--http-port", given.http_port,
                 "Port of WebSocket, the page, /stats and /metrics; 0: any free one, -1: off")
      ->check(CLI::Range(-1, 65535));
  app.add_option("--upstream-http-port", given.upstream_http_port,
                 "HTTP port of the server that --to names, from which textures come (7480 unless given)")
      ->check(CLI::Range(1, 65535));
  app.add_option("--token-file", given.token_file,
                 "File whose first line is the token for that server; else $INCISE_TOKEN");
  app.add_option("--ca", given.ca_file,
                 "PEM file of the authority that signed that server's certificate, and that of NATS");
  const CLI::Option* const check = incise::app::add_check_option(app, check_file);
  app.add_flag("--print-config", print_config,
               "Print a configuration with all keys, their defaults and meanings");
  incise::app::add_manual_options(app, 8);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);
    std::fprintf(stderr, "incise-relay: %s; see incise-relay --help\n", error.what());
    return incise::client::kWrongUsage;
  }
  const std::string wrong_check = incise::app::find_checked_file(*check, config_file, check_file);
  if (!wrong_check.empty()) {
    std::fprintf(stderr, "incise-relay: %s; see incise-relay --help\n", wrong_check.c_str());
    return incise::client::kWrongUsage;
  }
  const std::int64_t now_s = incise::unix_ns() / 1'000'000'000;
  try {
    if (print_config) {
      std::fputs(incise::app::commented({}, Program::kRelay).c_str(), stdout);
      return 0;
    }
    if (!check_file.empty()) {
      const Config config = incise::app::load_config(check_file, Program::kRelay);
      incise::app::check_relay_config(config, check_file);
      for (const std::string& warning : incise::app::certificate_warnings(config, now_s))
        std::printf("%s: warning: %s\n", check_file.c_str(), warning.c_str());
      std::printf("%s: good\n", check_file.c_str());
      return 0;
    }
    if (config_file.empty() && given.to.empty() && given.session.empty()) {
      std::fputs(app.help().c_str(), stdout);
      return 0;
    }
    Config config = config_file.empty() ? Config() : incise::app::load_config(config_file, Program::kRelay);
    override_with(given, config);
    incise::app::check_relay_config(config, config_file.empty() ? "incise-relay" : config_file);
    const incise::app::EndSignals signals;
    incise::app::start_log(config.log, "incise-relay");
    for (const std::string& warning : incise::app::certificate_warnings(config, now_s))
      spdlog::warn("{}", warning);
    incise::app::return_freed_memory();
    try {
      incise::app::run_relay(config, signals);
    } catch (...) {
      spdlog::shutdown();  // so that the log comes before the reason
      throw;
    }
    spdlog::shutdown();
    return 0;
  } catch (const incise::client::UsageError& error) {
    std::fprintf(stderr, "incise-relay: %s\n", error.what());
    return incise::client::kWrongUsage;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "incise-relay: %s\n", error.what());
    return incise::client::kFailed;
  }
}

}  // namespace

int main(int argc, char** argv) {
  return incise::end_standard_output("incise-relay", run(argc, argv));
}
