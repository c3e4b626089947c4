#pragma once

#include <string>

#include "protocol/messages.hpp"

namespace incise::stream {

// Why a message is not done: what an Error says.
struct Refusal {
  protocol::ErrorCode code = protocol::ErrorCode::Unknown;
  std::string text;
};

}  // namespace incise::stream
