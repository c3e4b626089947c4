#pragma once

#include <string>

#include "server/app/config.hpp"

namespace incise::app {

// Makes spdlog's default logger: lines on the standard error, written by a thread of its own. End it with spdlog::shutdown().
void start_log(const Config::Log& log, const std::string& program);
// A line of a part that knows no spdlog. From any thread.
void log_line(bool warning, const std::string& line);

}  // namespace incise::app
