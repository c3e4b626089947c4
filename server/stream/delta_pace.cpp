#include "server/stream/delta_pace.hpp"

#include <chrono>
#include <utility>

#include "server/base/clock.hpp"

namespace incise::stream {

void DeltaPace::set_rate(float max_hz) {
  max_hz_ = max_hz;
  next_ns_ = 0;
}

bool DeltaPace::allow(const std::shared_ptr<void>& keep, std::function<void()> again) {
  if (max_hz_ <= 0) return true;
  const std::int64_t now = monotonic_ns();
  if (now >= next_ns_) {
    next_ns_ = now + static_cast<std::int64_t>(1e9 / static_cast<double>(max_hz_));
    return true;
  }
  if (std::exchange(armed_, true)) return false;
  timer_.expires_after(std::chrono::nanoseconds(next_ns_ - now));
  timer_.async_wait(
      [this, weak = std::weak_ptr<void>(keep), again = std::move(again)](boost::system::error_code) {
        const auto alive = weak.lock();
        if (!alive) return;
        armed_ = false;
        again();
      });
  return false;
}

}  // namespace incise::stream
