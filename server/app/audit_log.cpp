#include "server/app/audit_log.hpp"

#include "server/base/clock.hpp"

namespace incise::app {

void AuditLog::write(stream::Audit kind, const std::string& address, const std::string& line) {
  const bool refused = kind == stream::Audit::kRefused;
  input::LimitedLog& log = refused ? refused_ : kind == stream::Audit::kBlade ? blades_ : resets_;
  log.write(refused ? spdlog::level::warn : spdlog::level::info, address, line, monotonic_ns());
}

void AuditLog::flush() {
  for (input::LimitedLog* log : {&refused_, &blades_, &resets_}) log->flush(monotonic_ns());
}

}  // namespace incise::app
