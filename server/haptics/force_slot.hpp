#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>

#include "server/core/cut/cut_config.hpp"
#include "server/haptics/latest.hpp"

namespace incise::haptics {

// What a device is to make its user feel until the next command.
struct ForceCommand {
  std::array<double, 3> newtons{};  // on the hand at the tool's origin, world frame
  std::int64_t time_ns = 0;  // CLOCK_MONOTONIC when it was computed: a device lets an old one fade to 0
  std::uint32_t flags = 0;   // ForceFlag, for displays and logs: the force is final without them
  std::int64_t pose_ns = 0;  // CLOCK_MONOTONIC when the pose arrived that it belongs to
  std::array<double, 3> newton_metres{};  // on the hand about the tool's origin, world frame

  friend bool operator==(const ForceCommand&, const ForceCommand&) = default;
};

enum ForceFlag : std::uint32_t {
  kForceContact = 1,    // the blade touches tissue
  kForceLimited = 2,    // a limit made the force smaller
  kForceRamping = 4,    // still growing after a first contact or a fault
  kForceLatchedOff = 8  // off until armed again
};

// The newest force for one source, from the loop to the thread that writes to the source's device (Latest); and, the
// other way, what the loop must know of that device.
//
// Thread: as Latest, the loop writes and the device's thread reads; each function says whose it is.
class ForceSlot : public Latest<ForceCommand> {
 public:
  // The device's: it is there, and can make this force at most (newtons, > 0), and this torque (N m; 0: none).
  void device_came(double max_newtons, double max_newton_metres = 0) noexcept {
    torque_limit_.store(max_newton_metres, std::memory_order_relaxed);
    limit_.store(max_newtons, std::memory_order_release);
  }
  // The device's: it was unplugged, or its thread has ended.
  void device_lost() noexcept {
    limit_.store(0, std::memory_order_release);
    torque_limit_.store(0, std::memory_order_relaxed);
    losses_.fetch_add(1, std::memory_order_release);
  }
  // The device's: a report could not be written. The device may still hold the last force.
  void write_failed() noexcept { failed_writes_.fetch_add(1, std::memory_order_release); }

  // Any: the largest force that the device can make, newtons; 0: no device makes forces.
  double limit() const noexcept { return limit_.load(std::memory_order_acquire); }
  // Any: the largest torque, N m; 0: it makes none.
  double torque_limit() const noexcept { return torque_limit_.load(std::memory_order_relaxed); }
  // Any: how often so far. A change since the last look is a fault of the device.
  std::uint32_t losses() const noexcept { return losses_.load(std::memory_order_acquire); }
  std::uint32_t failed_writes() const noexcept { return failed_writes_.load(std::memory_order_acquire); }

 private:
  static_assert(std::atomic<double>::is_always_lock_free);
  std::atomic<double> limit_{0}, torque_limit_{0};
  std::atomic<std::uint32_t> losses_{0}, failed_writes_{0};
};

// One for each pose source, by its number.
using ForceSlots = std::array<ForceSlot, core::kMaxSources>;

}  // namespace incise::haptics
