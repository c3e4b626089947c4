#pragma once

// What the tests of relays share: incise-relay in a process of its own, viewers that remember what they were shown, and a wire that
// can be cut and falsified.

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "client/client.hpp"
#include "protocol/framing.hpp"
#include "tests/e2e/process.hpp"

namespace incise::relay {

// incise-relay of one server, with a folder that goes with this. After its first start it listens where it did then.
class RelayProcess {
 public:
  // `more`: keys of its configuration after "relay" and "listen", with a comma in front; `listen`: more keys of listen, likewise.
  RelayProcess(const std::string& upstream, std::uint16_t upstream_http_port, const std::string& listen = "",
               const std::string& relay = "");
  ~RelayProcess();
  // False where it does not listen within a minute.
  bool start();
  void kill();
  // Whom it follows from its next start on.
  void follow(const std::string& upstream, std::uint16_t upstream_http_port) {
    upstream_ = upstream;
    upstream_http_port_ = upstream_http_port;
  }
  e2e::Process& process() { return *process_; }
  std::uint16_t tcp_port() const { return tcp_port_; }
  std::uint16_t http_port() const { return http_port_; }
  std::string place() const { return "127.0.0.1:" + std::to_string(tcp_port_); }
  std::string file(const std::string& name) const { return (directory_ / name).string(); }
  std::string log() const;
  std::optional<double> stat(const std::string& pointer) const;
  // The status code of GET /healthz.
  int health() const;

 private:
  std::filesystem::path directory_;
  std::string upstream_, listen_, relay_;
  std::uint16_t upstream_http_port_, tcp_port_ = 0, http_port_ = 0;
  std::unique_ptr<e2e::Process> process_;
};

// The hashes of the revisions that a viewer was brought to.
using Seen = std::map<std::uint64_t, std::uint64_t>;

// A viewer that comes back when it is lost, remembers what it was shown, and notices what must not be.
class Witness {
 public:
  explicit Witness(std::uint16_t port, client::Options options = {});
  Seen seen() const;
  client::Client& client() { return *client_; }
  // Revisions that went back without a Welcome in between.
  int went_back() const { return went_back_; }
  // Times that its own replica did not take what came.
  int resyncs() const { return resyncs_; }
  // Welcomes that brought another session than the one before.
  int epochs() const { return epochs_; }
  int welcomes() const { return welcomes_; }

 private:
  void note(std::uint64_t revision, std::uint64_t hash);
  mutable std::mutex mutex_;
  Seen seen_;               // guarded by mutex_
  std::uint64_t last_ = 0;  // the client's thread's
  std::uint64_t session_ = 0;
  std::atomic<int> went_back_{0}, resyncs_{0}, epochs_{0}, welcomes_{0};
  std::unique_ptr<client::Client> client_;  // ends first
};

// Whether both have the same hash wherever they have the same revision; how many those are.
int common(const Seen& a, const Seen& b, bool& equal);

// A wire between a server and whoever connects here.
class Wire {
 public:
  // What becomes of one message of the server: the bytes for the wire, perhaps none; nothing: it goes on as it is.
  using Meddle = std::function<std::optional<std::vector<std::byte>>(std::span<const std::byte> body)>;
  explicit Wire(std::uint16_t server_port);
  ~Wire();
  std::uint16_t port() const { return port_; }
  // From now on every message of the server goes through `meddle`.
  void meddle(Meddle meddle);
  // Ends all connections, and takes none for now, or again.
  void cut(bool severed);

 private:
  void serve();
  void run(int client);
  void pump_down(int from, int to);
  const std::uint16_t server_port_;
  int listener_;
  std::uint16_t port_ = 0;
  std::atomic<bool> stop_{false}, severed_{false};
  std::mutex mutex_;
  Meddle meddle_;             // guarded by mutex_
  std::vector<int> sockets_;  // guarded by mutex_
  std::vector<std::thread> threads_;
  std::thread acceptor_;
};

}  // namespace incise::relay
