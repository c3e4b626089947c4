#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>

#include "protocol/messages.hpp"

namespace incise::client {

// The server's monotonic clock against ours, from the last pings (Cristian 1989, "Probabilistic clock
// synchronization": the shortest round trip gives the best bound).
//
// Thread: add() from the client's thread; the results from any.
class ClockEstimate {
 public:
  static constexpr std::size_t kPings = 16;

  void add(const protocol::Pong& pong, std::int64_t received_ns);

  // The server's clock minus ours, and the round trip that this comes from; 0 until the first answer.
  std::int64_t offset_ns() const { return offset_ns_; }
  std::int64_t round_trip_ns() const { return round_trip_ns_; }

 private:
  struct Ping {
    std::int64_t round_trip_ns, offset_ns;
  };
  std::deque<Ping> pings_;
  std::atomic<std::int64_t> offset_ns_{0}, round_trip_ns_{0};
};

}  // namespace incise::client
