#pragma once

#include <string>

namespace incise::client {

// A name that another client has chosen, safe for a terminal.
inline std::string printable(const std::string& name) {
  std::string out;
  for (const char c : name) out += c >= ' ' && c <= '~' && c != '"' ? c : '?';
  return out;
}

// The same in quotes.
inline std::string shown_name(const std::string& name) {
  return '"' + printable(name) + '"';
}

}  // namespace incise::client
