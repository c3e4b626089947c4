#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "server/base/histogram.hpp"
#include "server/haptics/force_slot.hpp"
#include "server/input/force_guard.hpp"
#include "server/input/hid/hid_system.hpp"
#include "server/input/hid/pose_decoder.hpp"
#include "server/input/pose_sources.hpp"

namespace incise::input {

// Figures of an open device.
struct DeviceFigures {
  ReportCounts reports;
  double drift_ppm = 0;             // of its clock; > 0: slow
  std::uint64_t full_queue_ms = 0;  // spent waiting for the loop to take poses
  std::uint64_t forces_written = 0, forces_failed = 0;
  struct {
    double p50_us = 0, p99_us = 0, p999_us = 0, max_us = 0;
  } pose_to_report;  // from a pose's arrival until the report with its force was written
};

// An open device: reads its reports, queues the poses of its tools for the loop, and writes the newest force to it.
//
// Thread: made and destroyed by one thread; status by any. Owns: a reading thread with a handle of its own and, where the
// profile has forces, a writing thread with another; a pose source for each tool. A report wakes the reader, which reads
// all that wait: a cut needs every pose.
class HidDevice {
 public:
  struct Setup {
    HidInterface interface;
    DeviceProfile profile;
    Placement placement;
    std::string name;  // of its source, or the beginning of its sources' names
  };
  struct Surroundings {
    PoseSources& sources;
    haptics::ForceSlots& forces;
    std::function<void()> on_thread;  // called first in each of its threads
    std::function<void()> on_loss;    // called by the reader when the device has gone
  };

  // Sends the profile's start reports and begins to read. Null, and the reason in `error`, if the device cannot be opened
  // or no blade is free. `all`: the connected interfaces, for start reports to others of the same device.
  static std::unique_ptr<HidDevice> open(Setup setup, const std::vector<HidInterface>& all,
                                         const Surroundings& surroundings, std::string& error);
  // Ends the strokes; zeroes the force and sends the stop reports if the device is still there.
  ~HidDevice();
  HidDevice(const HidDevice&) = delete;
  HidDevice& operator=(const HidDevice&) = delete;

  const Setup& setup() const { return setup_; }
  std::vector<std::string> sources() const;
  bool lost() const { return lost_.load(std::memory_order_acquire); }
  DeviceFigures figures() const;

 private:
  HidDevice(Setup setup, const Surroundings& surroundings);
  bool open_sources(std::string& error);
  bool open_handles(const std::vector<HidInterface>& all, std::string& error);
  void read_loop(const std::stop_token& stop);
  void handle_report(std::span<const std::uint8_t> report, const std::stop_token& stop);
  void enqueue(const PoseDecoder::Sample& sample, std::int64_t arrival_ns, const std::stop_token& stop);
  void lose();
  void publish_figures();
  void write_loop(const std::stop_token& stop);

  const Setup setup_;
  const Surroundings surroundings_;
  haptics::ForceSlot* slot_ = nullptr;  // if the profile has forces
  std::optional<HidHandle> reading_, writing_;
  std::vector<PoseSource> sources_;
  PoseDecoder decoder_;                     // the reader's
  std::array<bool, kMaxTools> in_sight_{};  // the reader's
  std::uint64_t full_queue_ms_ = 0;         // the reader's
  std::atomic<bool> lost_{false};
  std::atomic<std::uint64_t> forces_written_{0}, forces_failed_{0};
  Histogram pose_to_report_;  // the writer's
  mutable std::mutex mutex_;  // guards shared_; the reader only tries it
  DeviceFigures shared_;
  std::jthread reader_, writer_;
};

// Turns commands into force reports, through the guard.
//
// Thread: one.
class ForceReport {
 public:
  ForceReport(const ForceProfile& profile, const PoseDecoder& axes);
  // The report for the newest command; `now_ns` CLOCK_MONOTONIC.
  std::span<const std::uint8_t> make(const haptics::ForceCommand& newest, std::int64_t now_ns) noexcept;
  std::span<const std::uint8_t> zero() noexcept;
  void failed() noexcept { guard_.failed(); }

 private:
  const ForceProfile& profile_;
  const PoseDecoder& axes_;
  std::vector<std::uint8_t> bytes_;
  ForceGuard guard_;
};

}  // namespace incise::input
