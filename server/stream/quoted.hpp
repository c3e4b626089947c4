#pragma once

#include <string>

#include "protocol/printable.hpp"

namespace incise::stream {

// A peer's text, safe to write to a log.
inline std::string quoted(const std::string& text) {
  return '"' + protocol::printable(text, 64) + '"';
}

}  // namespace incise::stream
