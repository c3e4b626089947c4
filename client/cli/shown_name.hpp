#pragma once

#include <string>

#include "protocol/printable.hpp"

namespace incise::client {

// A name that another client has chosen, safe for a terminal, in quotes.
inline std::string shown_name(const std::string& name) {
  return '"' + protocol::printable(name) + '"';
}

}  // namespace incise::client
