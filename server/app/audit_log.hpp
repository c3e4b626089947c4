#pragma once

#include <array>
#include <string>

#include "server/input/limited_log.hpp"
#include "server/stream/server.hpp"

namespace incise::app {

// Log lines on who was refused, and on what peers did that others notice. Each kind has limits of its own.
//
// Thread: any.
class AuditLog {
 public:
  void write(stream::Audit kind, const std::string& address, const std::string& line);
  // Writes what the limits have held back for long enough. About once a second.
  void flush();

 private:
  std::array<input::LimitedLog, stream::kAudits> logs_;
};

}  // namespace incise::app
