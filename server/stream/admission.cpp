#include "server/stream/admission.hpp"

#include <fcntl.h>
#include <sys/socket.h>
#include <unistd.h>

namespace incise::stream {

Admission::Admission(const StreamConfig& config, std::shared_ptr<SharedCounters> counters)
    : shared_(std::make_shared<Shared>()) {
  shared_->counters = std::move(counters);
  shared_->max_peers = config.max_sessions;
  shared_->max_handshakes = config.max_handshakes;
}

Admission::HalfOpen::~HalfOpen() {
  while (!sockets.empty()) close(sockets.begin());
}

void Admission::HalfOpen::close(std::map<std::uint64_t, int>::iterator which) {
  if (which->second >= 0) ::close(which->second);
  sockets.erase(which);
}

std::optional<Ticket> Admission::admit(asio::ip::tcp::socket& socket) {
  SharedCounters& counters = *shared_->counters;
  if (stopping_) {
    ++counters.refused;
    return std::nullopt;
  }
  auto& sockets = shared_->half_open.sockets;
  if (!sockets.empty() && sockets.size() >= shared_->max_handshakes) {
    // Its reader finds the end of the connection and releases the rest.
    const auto oldest = sockets.begin();
    ::shutdown(oldest->second, SHUT_RDWR);
    shared_->half_open.close(oldest);
    ++counters.half_open_closed;
  }
  const std::uint64_t number = ++counters.accepted;
  sockets.emplace(number, ::fcntl(socket.native_handle(), F_DUPFD_CLOEXEC, 0));
  boost::system::error_code gone;  // then its address is 0.0.0.0
  return Ticket(shared_, number, socket.remote_endpoint(gone));
}

Ticket::Ticket(std::shared_ptr<Admission::Shared> shared, std::uint64_t number,
               asio::ip::tcp::endpoint address)
    : shared_(std::move(shared)), number_(number), address_(std::move(address)) {
  ++shared_->counters->connections;
}

Ticket::Ticket(Ticket&& other) noexcept
    : shared_(std::exchange(other.shared_, nullptr)),
      number_(other.number_),
      address_(std::move(other.address_)),
      has_place_(std::exchange(other.has_place_, false)) {}

Ticket::~Ticket() {
  if (!shared_) return;
  leave_half_open();
  free_place();
  --shared_->counters->connections;
}

bool Ticket::take_place() {
  SharedCounters& counters = *shared_->counters;
  if (counters.peers.load(std::memory_order_relaxed) >= shared_->max_peers) return false;
  leave_half_open();
  has_place_ = true;
  ++counters.peers;
  return true;
}

void Ticket::free_place() {
  if (std::exchange(has_place_, false)) --shared_->counters->peers;
}

void Ticket::leave_half_open() {
  Admission::HalfOpen& half_open = shared_->half_open;
  if (const auto mine = half_open.sockets.find(number_); mine != half_open.sockets.end())
    half_open.close(mine);
}

}  // namespace incise::stream
