#include "server/input/hid/device_clock.hpp"

#include <algorithm>
#include <cmath>

namespace incise::input {
namespace {

constexpr double kWindow_ns = 1e9;
constexpr double kMostSlope = 2e-3;       // quartz is within 1e-4, a resonator on a chip within 1e-2 at worst
constexpr double kCorrection_ns = 0.5e9;  // an error is corrected in about this time ...
constexpr double kMostCorrection = 0.1;   // ... but no faster than this
constexpr double kLeap_ns = 1e9;

}  // namespace

DeviceClock::DeviceClock(double tick_s, unsigned bits) noexcept
    : tick_ns_(tick_s * 1e9),
      mask_((std::uint64_t{1} << bits) - 1),
      period_ns_(tick_ns_ * std::ldexp(1.0, static_cast<int>(bits))) {}

void DeviceClock::anchor(std::uint64_t count, std::int64_t arrival_ns) noexcept {
  // Never backwards: earlier times have been handed out.
  const std::int64_t after = running_ ? zero_ns_ + static_cast<std::int64_t>(host_ns_) + 1 : arrival_ns;
  zero_ns_ = std::max(arrival_ns, after);
  device_ns_ = host_ns_ = 0;
  window_start_ns_ = 0;
  window_least_ns_ = static_cast<double>(arrival_ns - zero_ns_);
  windows_ = 0;
  slope_ = 0;
  running_ = true;
  last_count_ = count;
  last_arrival_ns_ = arrival_ns;
}

void DeviceClock::end_window() noexcept {
  const double length = device_ns_ - window_start_ns_;
  if (windows_ > 0 && length < 3 * kWindow_ns) {
    const double between = window_start_ns_ - last_start_ns_;
    const double measured =
        std::clamp((window_least_ns_ - last_least_ns_) / between, -kMostSlope, kMostSlope);
    slope_ += (measured - slope_) / static_cast<double>(std::min<std::uint64_t>(windows_, 8));
  }
  last_least_ns_ = window_least_ns_;
  last_start_ns_ = window_start_ns_;
  window_least_ns_ = INFINITY;
  window_start_ns_ = device_ns_;
  ++windows_;
}

std::int64_t DeviceClock::host_ns(std::uint64_t count, std::int64_t arrival_ns) noexcept {
  if (!running_) {
    anchor(count, arrival_ns);
    return zero_ns_;
  }
  const double waited = static_cast<double>(arrival_ns - last_arrival_ns_);
  double step = static_cast<double>((count - last_count_) & mask_) * tick_ns_;
  step += std::max(0.0, std::round((waited - step) / period_ns_)) * period_ns_;  // whole turns of the counter
  if (std::abs(step - waited) > kLeap_ns) {
    ++restarts_;
    anchor(count, arrival_ns);
    return zero_ns_;
  }
  last_count_ = count;
  last_arrival_ns_ = arrival_ns;
  device_ns_ += step;
  // Offsets at the beginning of their window, using the drift known so far.
  const double since = slope_ * (device_ns_ - window_start_ns_);
  const double offset = static_cast<double>(arrival_ns - zero_ns_) - device_ns_ - since;
  window_least_ns_ = std::min(window_least_ns_, offset);
  // The best guess of the least offset now: that of the last window, or a lower one since, advanced by the drift.
  double least = window_least_ns_ + since;
  if (windows_ > 0) least = std::min(least, last_least_ns_ + slope_ * (device_ns_ - last_start_ns_));
  if (step > 0) {
    const double error = device_ns_ + least - host_ns_ - step;
    const double correction =
        std::clamp(error * step / kCorrection_ns, -kMostCorrection * step, kMostCorrection * step);
    host_ns_ += std::max(1.0, step + correction);
  }
  if (device_ns_ - window_start_ns_ >= kWindow_ns) end_window();
  return zero_ns_ + static_cast<std::int64_t>(host_ns_);
}

}  // namespace incise::input
