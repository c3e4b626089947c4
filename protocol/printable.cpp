#include "protocol/printable.hpp"

#include <algorithm>
#include <array>
#include <cstdint>

namespace incise::protocol {
namespace {

struct CodePoint {
  std::uint32_t value = 0;
  std::size_t bytes = 0;  // 0: this is not UTF-8
};

bool continues(char c) {
  return (static_cast<unsigned char>(c) & 0xc0) == 0x80;
}

// The first one of a text that is not empty. Neither longer than need be, nor a surrogate, nor beyond U+10FFFF (Unicode 15, table 3-7).
CodePoint first_of(std::string_view text) {
  const auto lead = static_cast<unsigned char>(text[0]);
  if (lead < 0x80) return {lead, 1};
  const std::size_t bytes = lead >= 0xf0 ? 4 : lead >= 0xe0 ? 3 : 2;
  if (lead < 0xc2 || lead > 0xf4 || text.size() < bytes) return {};
  std::uint32_t value = lead & (0xffu >> (bytes + 1));
  for (std::size_t i = 1; i < bytes; ++i) {
    if (!continues(text[i])) return {};
    value = value << 6 | (static_cast<unsigned char>(text[i]) & 0x3fu);
  }
  constexpr std::array<std::uint32_t, 5> kLeast{0, 0, 0x80, 0x800, 0x10000};
  if (value < kLeast[bytes] || value > 0x10ffff || (value >= 0xd800 && value <= 0xdfff)) return {};
  return {value, bytes};
}

bool is_hidden(std::uint32_t c) {
  constexpr std::array<std::array<std::uint32_t, 2>, 10> kHidden{{{0, 0x1f},
                                                                  {0x7f, 0x9f},
                                                                  {0xad, 0xad},
                                                                  {0x61c, 0x61c},
                                                                  {0x200b, 0x200f},
                                                                  {0x2028, 0x202e},
                                                                  {0x2060, 0x206f},
                                                                  {0xfeff, 0xfeff},
                                                                  {0xfff0, 0xfffb},
                                                                  {0xe0000, 0xe0fff}}};
  return std::any_of(kHidden.begin(), kHidden.end(),
                     [c](const auto& range) { return c >= range[0] && c <= range[1]; });
}

}  // namespace

std::string printable(std::string_view text, std::size_t max_characters) {
  std::string out;
  for (; !text.empty() && max_characters > 0; --max_characters) {
    const CodePoint next = first_of(text);
    const std::string_view bytes = text.substr(0, std::max<std::size_t>(next.bytes, 1));
    if (next.bytes == 0 || is_hidden(next.value) || next.value == '"') {
      out += '?';
    } else {
      out += bytes;
    }
    text.remove_prefix(bytes.size());
  }
  return out;
}

std::size_t characters(std::string_view printable_text) {
  return static_cast<std::size_t>(
      std::count_if(printable_text.begin(), printable_text.end(), [](char c) { return !continues(c); }));
}

}  // namespace incise::protocol
