#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>

#include "server/core/cut/cut_config.hpp"

namespace incise::haptics {

// What a device is to make its user feel until the next command.
struct ForceCommand {
  std::array<double, 3> newtons{};  // on the hand at the tool's origin, world frame
  std::int64_t time_ns = 0;  // CLOCK_MONOTONIC when it was computed: a device lets an old one fade to 0
  std::uint32_t flags = 0;   // ForceFlag, for displays and logs: the force is final without them
  std::int64_t pose_ns = 0;  // CLOCK_MONOTONIC when the pose arrived that it belongs to

  friend bool operator==(const ForceCommand&, const ForceCommand&) = default;
};

enum ForceFlag : std::uint32_t {
  kForceContact = 1,    // the blade touches tissue
  kForceLimited = 2,    // a limit made the force smaller
  kForceRamping = 4,    // still growing after a first contact or a fault
  kForceLatchedOff = 8  // off until armed again
};

// The newest force for one source, from the loop to the thread that writes to the source's device; and, the other
// way, what the loop must know of that device. Nobody ever waits: a triple buffer, in which the two sides swap their
// own buffer for the one in the middle. A command that was not read before the next is written is lost, by intent.
//
// Thread: one writer and one reader at a time; a device's thread that takes over from another must come after it
// (joined). Each function says whose it is.
class ForceSlot {
 public:
  // The loop's: makes `command` the newest.
  void write(const ForceCommand& command) noexcept {
    buffers_[back_].command = command;
    back_ = middle_.exchange(static_cast<std::uint8_t>(back_ | kFresh), std::memory_order_acq_rel) & kIndex;
  }
  // The device's: sets `newest` to the newest command. False, and `newest` is as it was, where nothing was written
  // since the last call.
  bool read(ForceCommand& newest) noexcept {
    if ((middle_.load(std::memory_order_relaxed) & kFresh) == 0) return false;
    front_ = middle_.exchange(front_, std::memory_order_acq_rel) & kIndex;
    newest = buffers_[front_].command;
    return true;
  }

  // The device's: it is there, and can make this force at most (newtons, > 0).
  void device_came(double max_newtons) noexcept { limit_.store(max_newtons, std::memory_order_release); }
  // The device's: it was unplugged, or its thread has ended.
  void device_lost() noexcept {
    limit_.store(0, std::memory_order_release);
    losses_.fetch_add(1, std::memory_order_release);
  }
  // The device's: a report could not be written. The device may still hold the last force.
  void write_failed() noexcept { failed_writes_.fetch_add(1, std::memory_order_release); }

  // Any: the largest force that the device can make, newtons; 0: no device makes forces.
  double limit() const noexcept { return limit_.load(std::memory_order_acquire); }
  // Any: how often so far. A change since the last look is a fault of the device.
  std::uint32_t losses() const noexcept { return losses_.load(std::memory_order_acquire); }
  std::uint32_t failed_writes() const noexcept { return failed_writes_.load(std::memory_order_acquire); }

 private:
  static constexpr std::uint8_t kIndex = 3, kFresh = 4;
  static constexpr std::size_t kCacheLine = 64;
  static_assert(std::atomic<double>::is_always_lock_free);

  struct alignas(kCacheLine) Buffer {
    ForceCommand command;
  };
  std::array<Buffer, 3> buffers_;
  alignas(kCacheLine) std::uint8_t back_ = 0;                // the writer's buffer
  alignas(kCacheLine) std::uint8_t front_ = 1;               // the reader's
  alignas(kCacheLine) std::atomic<std::uint8_t> middle_{2};  // the buffer between them, | kFresh when unread
  std::atomic<double> limit_{0};
  std::atomic<std::uint32_t> losses_{0}, failed_writes_{0};
};

// One for each pose source, by its number.
using ForceSlots = std::array<ForceSlot, core::kMaxSources>;

}  // namespace incise::haptics
