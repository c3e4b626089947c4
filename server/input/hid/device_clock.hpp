#pragma once

#include <cstdint>

namespace incise::input {

// Converts a device's clock, a wrapping counter, to times of this machine's clock.
//
// A report arrives later than it was measured, by a delay that varies but has a floor. So the offset between the clocks
// is the minimum of (arrival - device time), taken over windows of a second, and the drift is how that minimum changes
// from window to window. Corrections are made by running up to 10 % faster or slower, so that time always rises and a
// motion's speed is right. The floor itself remains unknown: all times are late by the least delay.
//
// Thread: one. O(1) a report.
class DeviceClock {
 public:
  // `tick_s` seconds for each count of a counter of `bits` bits.
  DeviceClock(double tick_s, unsigned bits) noexcept;

  // When the report was measured, CLOCK_MONOTONIC ns. Rises with every count; a count that stands still gives the same
  // time again. A jump that the arrivals do not confirm within a second means that the clock restarted; a counter that
  // wraps in less than a second cannot show that.
  std::int64_t host_ns(std::uint64_t count, std::int64_t arrival_ns) noexcept;

  double drift_ppm() const noexcept { return slope_ * 1e6; }  // > 0: the device's clock is slow
  std::uint64_t restarts() const noexcept { return restarts_; }

 private:
  void anchor(std::uint64_t count, std::int64_t arrival_ns) noexcept;
  void end_window() noexcept;

  double tick_ns_;
  std::uint64_t mask_;
  double period_ns_;
  bool running_ = false;
  std::uint64_t last_count_ = 0;
  std::int64_t last_arrival_ns_ = 0;
  std::int64_t zero_ns_ = 0;  // arrival of the anchor; the times below count from there
  double device_ns_ = 0;      // by the device's clock
  double host_ns_ = 0;        // the last result
  double window_start_ns_ = 0, window_least_ns_ = 0, last_start_ns_ = 0, last_least_ns_ = 0;
  std::uint64_t windows_ = 0;
  double slope_ = 0;  // of the offset, per device ns
  std::uint64_t restarts_ = 0;
};

}  // namespace incise::input
