#include "server/app/cluster_commands.hpp"

#include <CLI/CLI.hpp>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "client/cli/usage.hpp"
#include "server/base/clock.hpp"
#include "server/cluster/directory.hpp"
#include "server/cluster/session_subjects.hpp"

namespace incise::app {
namespace {

using Json = nlohmann::ordered_json;

struct SessionsCommand {
  std::string nats;
  std::string credentials_file, ca_file;
  bool json = false;
};

std::string age(std::int64_t seconds) {
  if (seconds < 120) return std::to_string(seconds) + " s";
  if (seconds < 7200) return std::to_string(seconds / 60) + " min";
  return std::to_string(seconds / 3600) + " h";
}

cluster::NatsOptions options_of(const std::string& url, const std::string& credentials_file,
                                const std::string& ca_file) {
  if (const std::string bad = cluster::trouble_of_urls(url); !bad.empty())
    throw client::UsageError(bad + ": accepted is nats://HOST[:PORT] or tls://HOST[:PORT]");
  cluster::NatsOptions options{url, "incise", credentials_file, ca_file, {}, {}};
  if (options.credentials_file.empty()) {
    if (const char* file = std::getenv("INCISE_NATS_CREDENTIALS")) options.credentials_file = file;
  }
  if (options.ca_file.empty()) {
    if (const char* file = std::getenv("INCISE_NATS_CA")) options.ca_file = file;
  }
  return options;
}

int run_sessions(const SessionsCommand& command) {
  const cluster::NatsClient nats(options_of(command.nats, command.credentials_file, command.ca_file));
  const std::vector<cluster::DirectoryEntry> entries = cluster::list_directory(nats);
  const std::string json = cluster::sessions_json(entries);
  if (command.json) {
    std::printf("%s\n", json.c_str());
    return 0;
  }
  if (entries.empty()) {
    std::printf("no session is listed there\n");
    return 0;
  }
  std::printf("%-20s %-20s %8s %6s %-8s %s\n", "session", "body", "revision", "people", "age", "where");
  const std::int64_t now_s = unix_ns() / 1'000'000'000;
  for (const Json& session : Json::parse(json)) {
    std::string name = session["name"];
    for (const Json& place : session["places"]) {
      const bool first = !name.empty();
      const std::string where = place["tcp"].get<std::string>().empty() ? place["http"] : place["tcp"];
      std::printf("%-20s %-20s %8s %6s %-8s %s%s\n", name.c_str(),
                  first ? session["body"].get<std::string>().c_str() : "",
                  first ? std::to_string(session["revision"].get<std::uint64_t>()).c_str() : "",
                  first ? std::to_string(session["people"].get<std::uint64_t>()).c_str() : "",
                  first ? age(now_s - session["started_unix_s"].get<std::int64_t>()).c_str() : "",
                  where.c_str(), place["kind"] == "relay" ? "  (relay)" : "");
      name.clear();
    }
  }
  return 0;
}

}  // namespace

void add_cluster_commands(CLI::App& app, int& exit_code) {
  auto command = std::make_shared<SessionsCommand>();
  CLI::App* sub = app.add_subcommand("sessions", "List the sessions that are published on NATS");
  sub->add_option("nats", command->nats, "nats://HOST[:PORT] or tls://HOST[:PORT]; without a port 4222")
      ->required();
  sub->add_option("--credentials", command->credentials_file,
                  "Who we are there, as cluster.credentials_file; else $INCISE_NATS_CREDENTIALS");
  sub->add_option("--ca", command->ca_file,
                  "PEM file of the authority that signed its certificate; else $INCISE_NATS_CA");
  sub->add_flag("--json", command->json, "Print a JSON list, as GET /sessions");
  sub->callback([command, &exit_code] { exit_code = run_sessions(*command); });
}

std::string find_session(const std::string& address, bool to_watch) {
  const std::size_t scheme = address.rfind("nats://", 0) == 0       ? 7
                             : address.rfind("nats+tls://", 0) == 0 ? 11
                                                                    : 0;
  if (scheme == 0) return address;
  const std::size_t slash = address.find('/', scheme);
  const std::string name = slash == std::string::npos ? "" : address.substr(slash + 1);
  if (!cluster::is_session_name(name)) {
    throw client::UsageError("\"" + address +
                             "\": accepted is nats://HOST[:PORT]/SESSION, or nats+tls://HOST[:PORT]/SESSION");
  }
  const std::string url = (scheme == 7 ? "nats://" : "tls://") + address.substr(scheme, slash - scheme);
  const cluster::NatsClient nats(options_of(url, "", ""));
  std::string relay, server;
  for (const cluster::DirectoryEntry& entry : cluster::list_directory(nats)) {
    if (entry.session != name) continue;
    std::string where = entry.tcp;
    if (where.empty())
      where = (entry.http.rfind("https", 0) == 0 ? "wss" : "ws") + entry.http.substr(entry.http.find(':'));
    if (entry.kind == "relay" && relay.empty()) relay = where;
    if (entry.kind == "server") server = where;
  }
  const std::string found = relay.empty() || (!to_watch && !server.empty()) ? server : relay;
  if (found.empty())
    throw std::runtime_error(url + ": there is no session \"" + name + "\"; incise sessions " + url +
                             " lists them");
  std::fprintf(stderr, "session %s: %s\n", name.c_str(), found.c_str());
  return found;
}

}  // namespace incise::app
