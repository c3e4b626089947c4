#pragma once

#include <string>

#include "server/input/limited_log.hpp"
#include "server/stream/server.hpp"

namespace incise::app {

// Log lines on who was refused, and on what peers did that others notice. Each kind has limits of its own. Who takes or leaves a blade, resets or undoes has
// been let in, and each such line matters: a hundred at once, then one a second, come from an address before any is left out.
//
// Thread: any.
class AuditLog {
 public:
  void write(stream::Audit kind, const std::string& address, const std::string& line);
  // Writes what the limits have held back for long enough. About once a second.
  void flush();

 private:
  static constexpr input::LimitedLog::Limit kLetIn{100, 1};
  input::LimitedLog refused_, blades_{kLetIn}, resets_{kLetIn};
};

}  // namespace incise::app
