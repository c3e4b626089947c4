#include "client/cli/commands.hpp"

#include <CLI/CLI.hpp>
#include <array>
#include <cerrno>
#include <charconv>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "client/cli/option_checks.hpp"
#include "client/cli/usage.hpp"

namespace incise::client {
namespace {

// What incised listens on where its configuration does not say otherwise.
constexpr std::uint16_t kTcpPort = 7450, kHttpPort = 7480;

volatile std::sig_atomic_t g_interrupted = 0;

void on_signal(int) {
  g_interrupted = 1;
}

}  // namespace

void add_server_options(CLI::App& command, ServerOptions& server) {
  command.add_option("--token-file", server.token_file,
                     "File whose first line is the access token; else $INCISE_TOKEN");
  command.add_option("--ca", server.ca_file,
                     "PEM file of the authority that signed the server's certificate");
}

bool interrupted() {
  static const bool installed = [] {
    struct sigaction action {};
    action.sa_handler = on_signal;
    action.sa_flags = SA_RESETHAND;
    ::sigaction(SIGINT, &action, nullptr);
    ::sigaction(SIGTERM, &action, nullptr);
    return true;
  }();
  return installed && g_interrupted != 0;
}

Address parse_address(const std::string& text) {
  constexpr std::array<std::pair<const char*, std::pair<TransportKind, bool>>, 4> kSchemes{{
      {"tcp://", {TransportKind::kTcp, false}},
      {"tls://", {TransportKind::kTcp, true}},
      {"ws://", {TransportKind::kWebSocket, false}},
      {"wss://", {TransportKind::kWebSocket, true}},
  }};
  const auto fail = [&] {
    return UsageError("server \"" + text +
                      "\": accepted is [tcp://|tls://|ws://|wss://]HOST[:PORT], an IPv6 address in brackets; "
                      "without a port 7450, or 7480 for ws and wss");
  };
  Address address;
  std::string rest = text;
  for (const auto& [prefix, how] : kSchemes) {
    if (rest.rfind(prefix, 0) != 0) continue;
    std::tie(address.transport, address.tls) = how;
    rest = rest.substr(std::string(prefix).size());
    break;
  }
  // A colon within brackets belongs to an IPv6 address.
  const std::size_t bracket = rest.rfind(']');
  std::size_t colon = rest.rfind(':');
  if (bracket != std::string::npos && colon < bracket) colon = std::string::npos;
  address.host = rest.substr(0, colon);
  if (!address.host.empty() && address.host.front() == '[' && address.host.back() == ']') {
    address.host = address.host.substr(1, address.host.size() - 2);
  } else if (address.host.find_first_of("/:@[] ") != std::string::npos) {
    throw fail();
  }
  if (address.host.empty()) throw fail();
  if (colon == std::string::npos) {
    address.port = address.transport == TransportKind::kTcp ? kTcpPort : kHttpPort;
    return address;
  }
  const char* begin = rest.data() + colon + 1;
  const char* end = rest.data() + rest.size();
  const auto [stop, error] = std::from_chars(begin, end, address.port);
  if (error != std::errc() || stop != end || address.port == 0) throw fail();
  return address;
}

std::unique_ptr<Client> connect(const Address& where, const Options& options, Callbacks callbacks) {
  try {
    return Client::connect(where.host, where.port, options, std::move(callbacks));
  } catch (const ConnectError& error) {
    const std::string text = error.what();
    if (error.code == protocol::ErrorCode::Unauthorized && options.token.empty())
      throw ConnectError(text + "; give one with --token-file FILE or in INCISE_TOKEN", error.code);
    if (text.find("Connection refused") == std::string::npos) throw;
    throw ConnectError(text + "; does incised run there, on that port? It prints its ports when it starts");
  }
}

Options ServerOptions::options(Address& where) const {
  where = parse_address(address);
  Options options;
  options.transport = where.transport;
  options.tls = where.tls;
  options.ca_file = ca_file.string();
  options.client_name = "incise";
  if (!token_file.empty()) {
    std::ifstream in(token_file);
    if (!in) {
      throw std::runtime_error(token_file.string() +
                               ": cannot be opened: " + std::generic_category().message(errno));
    }
    std::getline(in, options.token);
    // A file that Windows has written ends its lines with another character.
    options.token.erase(options.token.find_last_not_of(" \t\r") + 1);
    if (options.token.empty()) throw std::runtime_error(token_file.string() + ": no token in its first line");
  } else if (const char* token = std::getenv("INCISE_TOKEN")) {
    options.token = token;
  }
  return options;
}

namespace {

const char* address_help(const FindServer& find) {
  return find ? "[tcp://|tls://|ws://|wss://]HOST[:PORT]; without a port 7450, or 7480 for ws and wss; or "
                "nats://HOST[:PORT]/SESSION, nats+tls://HOST[:PORT]/SESSION: where that is served"
              : "[tcp://|tls://|ws://|wss://]HOST[:PORT]; without a port 7450, or 7480 for ws and wss";
}

void add_stream(CLI::App& app, int& exit_code, const ReadMotion& read, const FindServer& find) {
  auto command = std::make_shared<StreamCommand>();
  CLI::App* sub = app.add_subcommand("stream", "Play a motion against a running server, at its own rate");
  sub->add_option("poses", command->poses, "A motion (TUM or CSV) or a capture")->required();
  sub->add_option("--to", command->server.address, address_help(find))->required();
  sub->add_option("--speed", command->speed, "Times the recorded rate; 0: as fast as the server takes them")
      ->check(number_from(0, 1000))
      ->capture_default_str();
  sub->add_flag("--loop", command->loop, "Over and over, until interrupted");
  sub->add_option("--from-source", command->from_source,
                  "Of a capture with several sources, the one to play; without, the first that has poses");
  sub->add_option("--source", command->source_name, "Name of the blade")
      ->check(name_of_a_blade())
      ->capture_default_str();
  sub->add_option(
         "--blade", command->blade,
         "hx,hy,hz:tx,ty,tz: heel and tip in the tool's frame, metres, instead of the server's blade")
      ->check(blade_edge());
  sub->add_flag("--take-over", command->take_over, "Take the blade from the client that holds it");
  sub->add_flag("--strict", command->strict,
                "Refuse a motion whose times do not rise, instead of skipping samples");
  sub->add_flag("--reset", command->reset,
                "First reset the body to the mesh as loaded, for everybody (the token's role is admin, too)");
  sub->add_flag("--json", command->json, "Print the summary as JSON");
  add_server_options(*sub, command->server);
  sub->callback([command, read, find, &exit_code] {
    if (find) command->server.address = find(command->server.address, false);
    exit_code = run_stream(*command, read(*command));
  });
}

void add_watch(CLI::App& app, int& exit_code, const FindServer& find) {
  auto command = std::make_shared<WatchCommand>();
  CLI::App* sub = app.add_subcommand("watch", "Follow a running server: revisions, rates, latency");
  sub->add_option("server", command->server.address, address_help(find))->required();
  sub->add_option("--view", command->view, "What to hold a replica of")
      ->check(CLI::IsMember({"volume", "surface"}))
      ->capture_default_str();
  sub->add_option("--max-rate", command->max_rate_hz, "Deltas a second at most; 0: one for each revision")
      ->check(number_from(0, 10'000));
  sub->add_option("--for", command->for_s, "Seconds; 0: until interrupted")->check(number_from(0));
  sub->add_option("--give-up-after", command->give_up_after_s,
                  "Seconds to try to connect again when the server has gone; 0: for ever")
      ->check(number_from(0))
      ->capture_default_str();
  sub->add_option("--until-revision", command->until_revision, "End when the replica is there")
      ->check(whole_number());
  sub->add_option("--save", command->save, "Write the replica's canonical bytes to this file at the end");
  sub->add_flag("--json", command->json, "Print JSON lines");
  add_server_options(*sub, command->server);
  sub->callback([command, find, &exit_code] {
    if (find) command->server.address = find(command->server.address, true);
    exit_code = run_watch(*command);
  });
}

void add_restart(CLI::App& app, int& exit_code, const FindServer& find, protocol::RestartKind kind,
                 const char* name, const char* does) {
  auto command = std::make_shared<RestartCommand>();
  command->kind = kind;
  CLI::App* sub = app.add_subcommand(name, does);
  sub->add_option("server", command->server.address, address_help(find))->required();
  sub->add_flag("--json", command->json, "Print what happened as JSON");
  add_server_options(*sub, command->server);
  sub->callback([command, find, &exit_code] {
    if (find) command->server.address = find(command->server.address, false);
    exit_code = run_restart(*command);
  });
}

}  // namespace

void add_network_commands(CLI::App& app, int& exit_code, const ReadMotion& read, const FindServer& find) {
  add_stream(app, exit_code, read, find);
  add_watch(app, exit_code, find);
  add_restart(app, exit_code, find, protocol::RestartKind::Undo, "undo",
              "Undo the last stroke that cut something, for everybody (role admin)");
  add_restart(app, exit_code, find, protocol::RestartKind::Reset, "reset",
              "Reset the body to the mesh as loaded, for everybody (role admin)");
}

}  // namespace incise::client
