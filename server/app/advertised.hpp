#pragma once

#include <cstdint>
#include <string>

#include "server/app/config.hpp"

namespace incise::app {

// How others reach a port of ours: "tcp://host:port", with TLS "tls://"; `web`: http or https. "" if there is none.
std::string advertised(const Config& config, std::uint16_t port, bool web);

}  // namespace incise::app
