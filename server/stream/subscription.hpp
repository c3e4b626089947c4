#pragma once

#include <optional>
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

}  // namespace incise::stream
