#pragma once

#include <atomic>
#include <cstdint>

namespace incise::input {

// Lets one thread sleep until a time, or until another one has something for it. A ring holds until it is forgotten; several
// count as one. A futex, so that ringing is a system call only where somebody sleeps, and waiting ends at an
// absolute time of CLOCK_MONOTONIC.
//
// Thread: ring() from any, the rest from one.
class Doorbell {
 public:
  void ring() noexcept {
    if (state_.exchange(kRung, std::memory_order_acq_rel) == kAsleep) wake();
  }
  bool rung() const noexcept { return state_.load(std::memory_order_acquire) == kRung; }
  // Call before looking for what there is: what comes after the look rings again.
  void forget() noexcept { state_.exchange(kIdle, std::memory_order_acq_rel); }
  // Returns at `ns` or once it is rung: true.
  bool wait_until(std::int64_t ns) noexcept;

 private:
  static constexpr std::uint32_t kIdle = 0, kRung = 1, kAsleep = 2;
  void wake() noexcept;
  std::atomic<std::uint32_t> state_{kIdle};
  static_assert(sizeof(state_) == sizeof(std::uint32_t) && std::atomic<std::uint32_t>::is_always_lock_free);
};

}  // namespace incise::input
