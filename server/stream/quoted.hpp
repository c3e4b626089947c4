#pragma once

#include <string>

namespace incise::stream {

// A peer's text, safe to write to a log.
inline std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text.substr(0, 64)) out += c >= ' ' && c <= '~' && c != '"' ? c : '?';
  return out + '"';
}

}  // namespace incise::stream
