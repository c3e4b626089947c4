#include "server/app/audit_log.hpp"

#include "server/base/clock.hpp"

namespace incise::app {

void AuditLog::write(stream::Audit kind, const std::string& address, const std::string& line) {
  const auto level = kind == stream::Audit::kRefused ? spdlog::level::warn : spdlog::level::info;
  logs_[static_cast<std::size_t>(kind)].write(level, address, line, monotonic_ns());
}

void AuditLog::flush() {
  for (input::LimitedLog& log : logs_) log.flush(monotonic_ns());
}

}  // namespace incise::app
