#pragma once

#include "server/app/config.hpp"

namespace incise::app {

// Runs a relay until SIGINT, SIGTERM or SIGHUP. Throws where it cannot start.
void run_relay(const Config& config);

}  // namespace incise::app
