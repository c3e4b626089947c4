#include "client/clock_estimate.hpp"

#include <algorithm>

namespace incise::client {

void ClockEstimate::add(const protocol::Pong& pong, std::int64_t received_ns) {
  const std::int64_t round_trip_ns = received_ns - pong.ping_sent_ns;
  if (round_trip_ns < 0) return;
  pings_.push_back({round_trip_ns, pong.received_ns - (pong.ping_sent_ns + round_trip_ns / 2)});
  if (pings_.size() > kPings) pings_.pop_front();
  const Ping best = *std::min_element(pings_.begin(), pings_.end(), [](const Ping& a, const Ping& b) {
    return a.round_trip_ns < b.round_trip_ns;
  });
  offset_ns_ = best.offset_ns;
  round_trip_ns_ = best.round_trip_ns;
}

}  // namespace incise::client
