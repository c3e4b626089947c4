#pragma once

#include "server/app/config.hpp"
#include "server/app/end_signals.hpp"

namespace incise::app {

// Runs a relay until SIGINT, SIGTERM or SIGHUP. Throws where it cannot start.
void run_relay(const Config& config, const EndSignals& signals);

}  // namespace incise::app
