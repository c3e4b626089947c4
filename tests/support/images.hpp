#pragma once

// Images of one pixel, for tests that need a file which is one.

#include <cstdint>
#include <string>

namespace incise::tests {

// `text`: makes images differ.
inline std::string tiny_png(const std::string& text = {}) {
  const auto word = [](std::uint32_t x) {
    return std::string{static_cast<char>(x >> 24), static_cast<char>(x >> 16), static_cast<char>(x >> 8),
                       static_cast<char>(x)};
  };
  const auto chunk = [&](const std::string& type_and_data) {
    std::uint32_t sum = 0xffffffff;
    for (const char c : type_and_data) {
      sum ^= static_cast<unsigned char>(c);
      for (int bit = 0; bit < 8; ++bit) sum = (sum & 1) != 0 ? (sum >> 1) ^ 0xedb88320 : sum >> 1;
    }
    return word(static_cast<std::uint32_t>(type_and_data.size() - 4)) + type_and_data + word(~sum);
  };
  const std::string data("IDAT\170\332\143\150\000\000\000\202\000\201", 14);
  return "\x89PNG\r\n\x1a\n" + chunk("IHDR" + word(1) + word(1) + std::string("\010\0\0\0\0", 5)) +
         (text.empty() ? "" : chunk("tEXtComment" + std::string(1, '\0') + text)) + chunk(data) +
         chunk("IEND");
}

inline std::string tiny_jpeg() {
  return std::string(
      "\377\330\377\333\000\103\000\003\002\002\002\002\002\003\002\002\002\003\003\003\003\004\006\004"
      "\004\004\004\004\010\006\006\005\006\011\010\012\012\011\010\011\011\012\014\017\014\012\013\016"
      "\013\011\011\015\021\015\016\017\020\020\021\020\012\014\022\023\022\020\023\017\020\020\020\377"
      "\311\000\013\010\000\001\000\001\001\001\021\000\377\314\000\006\000\020\020\005\377\332\000\010"
      "\001\001\000\000\077\000\322\317\040\377\331",
      107);
}

inline std::string tiny_webp() {
  return std::string(
      "\122\111\106\106\022\000\000\000\127\105\102\120\126\120\070\114\006\000\000\000\057\101\154\157"
      "\000\153",
      26);
}

}  // namespace incise::tests
