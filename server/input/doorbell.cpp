#include "server/input/doorbell.hpp"

#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <ctime>

namespace incise::input {

bool Doorbell::wait_until(std::int64_t ns) noexcept {
  std::uint32_t state = kIdle;
  if (state_.compare_exchange_strong(state, kAsleep, std::memory_order_acq_rel)) {
    const timespec until{ns / 1'000'000'000, ns % 1'000'000'000};
    do {
      const long ended = syscall(SYS_futex, &state_, FUTEX_WAIT_BITSET_PRIVATE, kAsleep, &until, nullptr,
                                 FUTEX_BITSET_MATCH_ANY);
      if (ended != 0 && errno == ETIMEDOUT) break;
    } while (state_.load(std::memory_order_acquire) == kAsleep);
  }
  // Nobody need wake it any more.
  state = kAsleep;
  return !state_.compare_exchange_strong(state, kIdle, std::memory_order_acq_rel);
}

void Doorbell::wake() noexcept {
  syscall(SYS_futex, &state_, FUTEX_WAKE_PRIVATE, 1, nullptr, nullptr, 0);
}

}  // namespace incise::input
