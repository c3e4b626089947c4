#include "server/input/limited_log.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>

#include "server/base/clock.hpp"

namespace incise::input {
namespace {

constexpr double kBurst = 10, kEach_s = 5;

}  // namespace

void LimitedLog::write(spdlog::level::level_enum level, const std::string& line) {
  const std::int64_t now = monotonic_ns();
  tokens_ = std::min(kBurst, tokens_ + 1e-9 * static_cast<double>(now - last_ns_) / kEach_s);
  last_ns_ = now;
  if (tokens_ < 1) {
    ++left_out_;
    return;
  }
  tokens_ -= 1;
  spdlog::log(level, "{}{}", line,
              left_out_ > 0 ? fmt::format(" ({} lines like this left out)", left_out_) : std::string());
  left_out_ = 0;
}

}  // namespace incise::input
