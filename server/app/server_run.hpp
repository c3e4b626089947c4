#pragma once

#include "server/app/config.hpp"
#include "server/app/end_signals.hpp"

namespace incise::app {

// Runs the server until SIGINT, SIGTERM or SIGHUP: mesh, loop, journal, stream; then ends them in an order that loses nothing.
// `resume`: continues the session that capture.path recorded. Logs through spdlog's default logger. Throws if the start
// fails, ConfigError, MeshError, std::runtime_error, and after the end if the capture lacks something, std::runtime_error: each one line.
void run_server(const Config& config, bool resume, const EndSignals& signals);

}  // namespace incise::app
