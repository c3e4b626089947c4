#include "tests/bench/crowd.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/epoll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <span>
#include <stdexcept>
#include <string>
#include <system_error>

#include "server/base/clock.hpp"
#include "server/input/pose_sources.hpp"

namespace incise::bench {
namespace {

constexpr int kHandshakesAtOnce = 32;  // below the server's cap

void send_message(int fd, const protocol::Body& body) {
  const protocol::Frame frame = protocol::encode(body, {1, 0});
  // A few bytes into an empty socket: all or nothing.
  (void)::send(fd, frame.tcp().data(), frame.tcp().size(), MSG_NOSIGNAL);
}

protocol::Hello viewer_hello(protocol::View view, const std::optional<protocol::Box>& box = std::nullopt) {
  protocol::Hello hello;
  hello.box = box;
  hello.role = protocol::Role::Viewer;
  hello.view = view;
  hello.client_name = "incise-bench";
  return hello;
}

template <class Condition>
bool wait_until(Condition condition, double seconds) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return true;
}

}  // namespace

std::size_t raise_descriptor_limit() {
  rlimit limit{};
  if (getrlimit(RLIMIT_NOFILE, &limit) != 0)
    throw std::system_error(errno, std::generic_category(), "getrlimit");
  limit.rlim_cur = limit.rlim_max;
  if (setrlimit(RLIMIT_NOFILE, &limit) != 0)
    throw std::system_error(errno, std::generic_category(), "setrlimit");
  return limit.rlim_cur;
}

Crowd::Crowd(std::uint16_t port, const Options& options) : epoll_(epoll_create1(EPOLL_CLOEXEC)) {
  if (epoll_ < 0) throw std::system_error(errno, std::generic_category(), "epoll_create1");
  peers_.reserve(static_cast<std::size_t>(options.viewers) + static_cast<std::size_t>(options.stalled) +
                 static_cast<std::size_t>(options.silent));
  thread_ = std::thread([this] { run(); });
  for (int i = 0; i < options.viewers; ++i) {
    send_message(connect(port, true, 0).fd, viewer_hello(options.view, options.box));
    const int at_least = i + 1 == options.viewers ? options.viewers : i + 1 - kHandshakesAtOnce;
    if (!wait_until([&] { return welcomed_ >= at_least; }, 60))
      throw std::runtime_error("viewer " + std::to_string(welcomed_) + " of " +
                               std::to_string(options.viewers) + " was not welcomed");
  }
  for (int i = 0; i < options.stalled; ++i)
    send_message(connect(port, false, 4096).fd, viewer_hello(protocol::View::Volume));
  for (int i = 0; i < options.silent; ++i) connect(port, false, 0);
}

Crowd::~Crowd() {
  stop();
  for (const auto& peer : peers_)
    if (peer->fd >= 0) ::close(peer->fd);
  ::close(epoll_);
}

Crowd::Peer& Crowd::connect(std::uint16_t port, bool reads, int receive_buffer) {
  auto peer = std::make_unique<Peer>();
  peer->reads = reads;
  peer->fd = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (peer->fd < 0) throw std::system_error(errno, std::generic_category(), "socket");
  if (receive_buffer > 0) setsockopt(peer->fd, SOL_SOCKET, SO_RCVBUF, &receive_buffer, sizeof receive_buffer);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  if (::connect(peer->fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    const int error = errno;
    ::close(peer->fd);
    throw std::system_error(error, std::generic_category(), "connect");
  }
  epoll_event event{};
  event.events = reads ? EPOLLIN : EPOLLRDHUP;
  event.data.ptr = peer.get();
  peers_.push_back(std::move(peer));
  epoll_ctl(epoll_, EPOLL_CTL_ADD, peers_.back()->fd, &event);
  return *peers_.back();
}

void Crowd::run() {
  std::array<epoll_event, 64> events;
  while (!stop_) {
    const int n = epoll_wait(epoll_, events.data(), static_cast<int>(events.size()), 50);
    for (int i = 0; i < n; ++i) {
      Peer& peer = *static_cast<Peer*>(events[static_cast<std::size_t>(i)].data.ptr);
      if (peer.reads) {
        read(peer);
      } else {
        ++silent_closed_;
        drop(peer);
      }
    }
  }
}

// The descriptor stays until the end: the threads never disagree about what it is.
void Crowd::drop(Peer& peer) {
  epoll_ctl(epoll_, EPOLL_CTL_DEL, peer.fd, nullptr);
}

void Crowd::read(Peer& peer) {
  const ssize_t n = ::recv(peer.fd, buffer_.data(), buffer_.size(), MSG_DONTWAIT);
  if (n < 0 && (errno == EAGAIN || errno == EINTR)) return;
  const std::int64_t now = monotonic_ns();
  std::span<const std::byte> input(buffer_.data(), static_cast<std::size_t>(n > 0 ? n : 0));
  while (peer.reader.read(input) == protocol::FrameReader::Status::Complete)
    take(peer, peer.reader.body(), now);
  if (n > 0 && !peer.reader.failed()) return;
  ++viewers_lost_;
  peer.revision = UINT64_MAX;
  drop(peer);
}

void Crowd::take(Peer& peer, std::span<const std::byte> body, std::int64_t received_ns) {
  const protocol::DecodeResult decoded = protocol::decode(body);
  if (!decoded) throw std::runtime_error("a message that cannot be read: " + decoded.error);
  const auto arrived = [&](const auto& delta) {
    latencies_ms_.push_back(1e-6 * static_cast<double>(received_ns - delta.steps.back().cut_ns));
    peer.revision = delta.revision;
  };
  const protocol::Body& message = decoded.message->body;
  if (const auto* surface = std::get_if<protocol::SurfaceDelta>(&message)) {
    arrived(*surface);
  } else if (const auto* delta = std::get_if<protocol::Delta>(&message)) {
    arrived(*delta);
  } else if (const auto* end = std::get_if<protocol::SnapshotEnd>(&message)) {
    peer.revision = end->revision;
  } else if (const auto* ping = std::get_if<protocol::Ping>(&message)) {
    send_message(peer.fd, protocol::Pong{ping->nonce, ping->sent_ns, 0});
  } else if (std::holds_alternative<protocol::Welcome>(message)) {
    ++welcomed_;
  } else if (const auto* error = std::get_if<protocol::Error>(&message)) {
    boxes_refused_ += error->code == protocol::ErrorCode::NotAvailable;
  }
}

bool Crowd::wait_for_revision(std::uint64_t revision, double seconds) const {
  return wait_until(
      [&] {
        for (const auto& peer : peers_)
          if (peer->reads && peer->revision < revision) return false;
        return true;
      },
      seconds);
}

const std::vector<double>& Crowd::stop() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
  return latencies_ms_;
}

}  // namespace incise::bench
