#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/messages.hpp"

namespace incise::stream {

// What a peer wants of the mesh: Hello or Subscribe says it.
struct Subscription {
  protocol::View view = protocol::View::None;
  std::optional<protocol::Box> box;
  float max_rate_hz = 0;            // deltas a second; 0: one for each revision
  std::vector<std::string> fields;  // names; "*": all
};

// Welcome.session for a peer that holds this of an epoch. A relay finds the epoch by the same: it is its own inverse.
std::uint64_t session_name(std::uint64_t epoch, protocol::View view, bool box,
                           std::span<const std::uint32_t> fields);

}  // namespace incise::stream
