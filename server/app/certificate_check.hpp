#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "server/app/config.hpp"

namespace incise::app {

// What to say at the start, and where a configuration is checked, of certificates that are not valid, or not for much longer, at a Unix time.
std::vector<std::string> certificate_warnings(const Config& config, std::int64_t now_unix_s);

}  // namespace incise::app
