#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace incise::protocol {

// Somebody else's text, safe for a terminal and a log: UTF-8 as it is, but "?" for what is not UTF-8, for control characters, for those that are not seen or
// turn the direction of writing, and for quotation marks. At most so many characters (code points).
std::string printable(std::string_view text, std::size_t max_characters = std::string_view::npos);

// Code points of what printable() gives.
std::size_t characters(std::string_view printable_text);

}  // namespace incise::protocol
