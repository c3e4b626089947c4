#pragma once

#include <cstdint>
#include <string>

namespace incise {

// 16 digits, as all hashes are shown.
inline std::string hex(std::uint64_t value) {
  std::string out(16, '0');
  for (std::size_t i = 16; i > 0; value >>= 4) out[--i] = "0123456789abcdef"[value & 15];
  return out;
}

}  // namespace incise
