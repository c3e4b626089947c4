#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace incise::input {

// What a source of poses on the network reports about itself, for /stats and /metrics.
struct NetworkStatus {
  struct Peer {
    std::string name;  // address, or what was configured
    bool connected = false;
    std::vector<std::string> sources;  // blades that it holds now
  };
  std::string protocol;
  std::vector<Peer> peers;
  std::vector<std::pair<std::string, std::uint64_t>> counts;  // since the start, by what was counted
};

}  // namespace incise::input
