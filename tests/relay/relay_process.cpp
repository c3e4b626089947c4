#include "tests/relay/relay_process.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstring>
#include <fstream>

#include "tests/e2e/served_session.hpp"
#include "tests/stream/raw_peer.hpp"

namespace incise::relay {
namespace {

namespace fs = std::filesystem;

std::atomic<int> g_relays{0};

sockaddr_in loopback(std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(port);
  return address;
}

bool write_all(int fd, std::span<const std::byte> bytes) {
  while (!bytes.empty()) {
    const ssize_t n = ::send(fd, bytes.data(), bytes.size(), MSG_NOSIGNAL);
    if (n <= 0) return false;
    bytes = bytes.subspan(static_cast<std::size_t>(n));
  }
  return true;
}

}  // namespace

RelayProcess::RelayProcess(const std::string& upstream, std::uint16_t upstream_http_port,
                           const std::string& listen, const std::string& relay)
    : directory_(fs::temp_directory_path() /
                 ("incise_relay_" + std::to_string(::getpid()) + "_" + std::to_string(++g_relays))),
      upstream_(upstream),
      listen_(listen),
      relay_(relay),
      upstream_http_port_(upstream_http_port) {
  fs::create_directories(directory_);
}

RelayProcess::~RelayProcess() {
  process_.reset();
  fs::remove_all(directory_);
}

bool RelayProcess::start() {
  std::ofstream(file("relay.json")) << R"({"relay": {"upstream": ")" << upstream_
                                    << R"(", "upstream_http_port": )" << upstream_http_port_ << relay_
                                    << R"(}, "listen": {"tcp_port": )" << tcp_port_ << R"(, "http_port": )"
                                    << http_port_ << listen_ << "}}";
  for (int attempt = 0; attempt < 20; ++attempt) {
    process_ = std::make_unique<e2e::Process>(
        std::vector<std::string>{"/bin/sh", "-c",
                                 "exec " + std::string(INCISE_BIN_DIR) + "/incise-relay --config " +
                                     file("relay.json") + " 2>>" + file("log.txt")});
    const std::string line = process_->line("listening ");
    tcp_port_ = line.empty() ? tcp_port_ : e2e::port_after(line, "tcp=");
    http_port_ = line.empty() ? http_port_ : e2e::port_after(line, "http=");
    if (!line.empty()) return true;
    if (process_->running()) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(200));  // a port of ours is somebody's other end
  }
  return false;
}

void RelayProcess::kill() {
  process_->signal(SIGKILL);
  process_->wait();
}

std::string RelayProcess::log() const {
  std::ifstream in(file("log.txt"));
  return std::string(std::istreambuf_iterator<char>(in), {});
}

std::optional<double> RelayProcess::stat(const std::string& pointer) const {
  return e2e::stat(http_port_, pointer);
}

int RelayProcess::health() const {
  const std::string answer = stream::http(http_port_, "/healthz");
  return answer.size() > 12 ? std::atoi(answer.c_str() + 9) : 0;
}

// ---- Viewers ----

Witness::Witness(std::uint16_t port, client::Options options) {
  options.reconnect = true;
  client::Callbacks callbacks;
  callbacks.on_welcome = [this](const protocol::Welcome& welcome) {
    ++welcomes_;
    if (session_ != 0 && session_ != welcome.session) ++epochs_;
    session_ = welcome.session;
    if (!welcome.resumed) last_ = 0;
  };
  callbacks.on_snapshot = [this](const protocol::SnapshotEnd& end, protocol::SnapshotCause) {
    note(end.revision, end.state_hash);
  };
  callbacks.on_delta = [this](const auto&, const protocol::Delta& delta, const auto&) {
    note(delta.revision, delta.state_hash);
  };
  callbacks.on_part_delta = [this](const auto&, const protocol::Delta& delta, const auto&) {
    note(delta.revision, delta.state_hash);
  };
  callbacks.on_surface_delta = [this](const auto&, const protocol::SurfaceDelta& delta, const auto&) {
    note(delta.revision, delta.state_hash);
  };
  callbacks.on_resync = [this](const std::string&) { ++resyncs_; };
  client_ = client::Client::connect("127.0.0.1", port, options, callbacks);
}

void Witness::note(std::uint64_t revision, std::uint64_t hash) {
  if (revision < last_) ++went_back_;
  last_ = revision;
  const std::scoped_lock lock(mutex_);
  seen_[revision] = hash;
}

Seen Witness::seen() const {
  const std::scoped_lock lock(mutex_);
  return seen_;
}

int common(const Seen& a, const Seen& b, bool& equal) {
  int shared = 0;
  for (const auto& [revision, hash] : a) {
    const auto other = b.find(revision);
    if (other == b.end()) continue;
    ++shared;
    equal = equal && other->second == hash;
  }
  return shared;
}

// ---- The wire ----

Wire::Wire(std::uint16_t server_port)
    : server_port_(server_port), listener_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
  const int on = 1;
  ::setsockopt(listener_, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  sockaddr_in address = loopback(0);
  socklen_t length = sizeof address;
  if (::bind(listener_, reinterpret_cast<sockaddr*>(&address), length) != 0 || ::listen(listener_, 64) != 0 ||
      ::getsockname(listener_, reinterpret_cast<sockaddr*>(&address), &length) != 0) {
    throw std::runtime_error("cannot listen");
  }
  port_ = ntohs(address.sin_port);
  acceptor_ = std::thread([this] { serve(); });
}

Wire::~Wire() {
  stop_ = true;
  cut(true);
  ::shutdown(listener_, SHUT_RDWR);
  acceptor_.join();
  for (std::thread& thread : threads_) thread.join();
  ::close(listener_);
}

void Wire::meddle(Meddle meddle) {
  const std::scoped_lock lock(mutex_);
  meddle_ = std::move(meddle);
}

void Wire::cut(bool severed) {
  severed_ = severed;
  if (!severed) return;
  const std::scoped_lock lock(mutex_);
  for (const int socket : sockets_) ::shutdown(socket, SHUT_RDWR);
}

void Wire::serve() {
  while (!stop_) {
    const int client = ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC);
    if (client < 0) continue;
    if (severed_) {
      ::close(client);
      continue;
    }
    threads_.emplace_back([this, client] { run(client); });
  }
}

void Wire::run(int client) {
  const int server = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const sockaddr_in address = loopback(server_port_);
  if (::connect(server, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) {
    {
      const std::scoped_lock lock(mutex_);
      sockets_.insert(sockets_.end(), {client, server});
    }
    std::thread up([client, server] {
      std::vector<std::byte> bytes(65536);
      for (ssize_t n; (n = ::recv(client, bytes.data(), bytes.size(), 0)) > 0;) {
        if (!write_all(server, std::span(bytes).first(static_cast<std::size_t>(n)))) break;
      }
      ::shutdown(server, SHUT_RDWR);
      ::shutdown(client, SHUT_RDWR);
    });
    pump_down(server, client);
    ::shutdown(server, SHUT_RDWR);
    ::shutdown(client, SHUT_RDWR);
    up.join();
    const std::scoped_lock lock(mutex_);
    std::erase_if(sockets_, [&](int socket) { return socket == client || socket == server; });
  }
  ::close(server);
  ::close(client);
}

void Wire::pump_down(int from, int to) {
  protocol::FrameReader reader;
  std::vector<std::byte> bytes(65536);
  for (ssize_t n; (n = ::recv(from, bytes.data(), bytes.size(), 0)) > 0;) {
    std::span<const std::byte> input = std::span(bytes).first(static_cast<std::size_t>(n));
    while (reader.read(input) == protocol::FrameReader::Status::Complete) {
      std::optional<std::vector<std::byte>> out;
      {
        const std::scoped_lock lock(mutex_);
        if (meddle_) out = meddle_(reader.body());
      }
      if (!out) {
        const auto size = static_cast<std::uint32_t>(reader.body().size());
        out.emplace(4);
        std::memcpy(out->data(), &size, 4);
        out->insert(out->end(), reader.body().begin(), reader.body().end());
      }
      if (!write_all(to, *out)) return;
    }
  }
}

}  // namespace incise::relay
