#pragma once

#include <string_view>

namespace incise::protocol {

// The blade of an operator whose Hello names none (PROTOCOL.md, section 7), and that clients ask for.
inline constexpr std::string_view kDefaultBladeName = "blade";

}  // namespace incise::protocol
