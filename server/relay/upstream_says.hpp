#pragma once

#include <string>

namespace incise::relay {

// Relays in a row from the server. More is a cycle: each relay in it counts one more than the one before.
inline constexpr int kMaxHops = 16;

// What an upstream says of itself in its statistics, if it is a relay.
struct UpstreamSays {
  int hops = 0;         // from it to the server, kMaxHops at most; 0 for a server
  std::string trouble;  // in plain characters, for logs and JSON; "": none
};

// `stats`: JSON, from anybody. What is not as a relay writes it says nothing.
UpstreamSays read_upstream(const std::string& stats);

// The same trouble for those that follow us: names the first relay that has it, however many are in between. "": none.
std::string trouble_at(const std::string& upstream, const UpstreamSays& says);

}  // namespace incise::relay
