#pragma once

#include <string>
#include <vector>

#include "protocol/messages.hpp"

namespace incise::client {

// A header and a line for each blade, none longer than 80 columns; empty where nobody holds one.
std::string blade_table(const std::vector<protocol::BladeStats>& blades);

}  // namespace incise::client
