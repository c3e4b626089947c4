#pragma once

// The commands of `incise` that talk to a running incised.

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>

#include "client/client.hpp"
#include "protocol/blade_name.hpp"
#include "protocol/motion.hpp"

namespace CLI {
class App;
}

namespace incise::client {

// Where a server is: [tcp://|tls://|ws://|wss://]HOST[:PORT], an IPv6 address in brackets. Plain is tcp; without a port it
// is the one that incised listens on by default.
struct Address {
  std::string host;
  std::uint16_t port = 0;
  TransportKind transport = TransportKind::kTcp;
  bool tls = false;
};
// Throws UsageError with what was found and what is accepted.
Address parse_address(const std::string& text);

struct ServerOptions {
  std::string address;
  std::filesystem::path token_file, ca_file;
  // Options for a session there. Throws UsageError, std::runtime_error.
  Options options(Address& where) const;
};

// Adds the options for the token and the authority.
void add_server_options(CLI::App& command, ServerOptions& server);

struct StreamCommand {
  std::filesystem::path poses;
  ServerOptions server;
  double speed = 1;  // times the recorded one; 0: as fast as they are taken
  bool loop = false;
  std::optional<std::uint32_t> from_source;  // of a capture; nothing: the first that has poses
  std::string source_name{protocol::kDefaultBladeName};
  std::string blade;  // hx,hy,hz:tx,ty,tz; empty: the server's
  bool take_over = false;
  bool strict = false;  // refuse a motion whose times do not rise
  bool reset = false;   // before the first pose
  bool json = false;
};
// Plays the motion against a server; waits until the server has dealt with every pose. 0: it has.
int run_stream(const StreamCommand& command, protocol::Motion motion);

struct WatchCommand {
  ServerOptions server;
  std::string view = "volume";
  double max_rate_hz = 0;
  double for_s = 0;                             // 0: until interrupted
  double give_up_after_s = 30;                  // without a connection; 0: never
  std::optional<std::uint64_t> until_revision;  // or until it is there
  std::filesystem::path save;                   // the replica's canonical bytes, at the end
  bool json = false;
};
// Shows what a server does, once a second. 0: interrupted, or what was waited for has come. 1: the server has gone, and
// did not come back in time.
int run_watch(const WatchCommand& command);

struct RestartCommand {
  ServerOptions server;
  protocol::RestartKind kind = protocol::RestartKind::Undo;
  bool json = false;
};
// Undoes the last stroke of all, or resets the body, as an administrator, and says what happened. Throws where the server refuses.
int run_restart(const RestartCommand& command);
// The same without a word: the Welcome that the server then sends. `options` names who asked.
protocol::Welcome restart_as_admin(const Address& where, Options options, protocol::RestartKind kind);

// Makes what --to and SERVER name into an address; `to_watch`: no blade is wanted there.
using FindServer = std::function<std::string(const std::string& named, bool to_watch)>;
// Reads the motion that a command names, and warns. It is the program's, which knows what of a capture counts.
using ReadMotion = std::function<protocol::Motion(const StreamCommand&)>;
// Adds the commands to `incise`; the one that runs sets the program's exit code. `find`: a program that knows directories looks there.
void add_network_commands(CLI::App& app, int& exit_code, const ReadMotion& read,
                          const FindServer& find = nullptr);

// Client::connect, and where nobody listens there, what to do about it. Throws ConnectError.
std::unique_ptr<Client> connect(const Address& where, const Options& options, Callbacks callbacks);

// Whether the program has been asked to end (SIGINT, SIGTERM), from the first call on: a second signal kills
// it.
bool interrupted();

}  // namespace incise::client
