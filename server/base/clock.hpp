#pragma once

#include <cstdint>
#include <ctime>

namespace incise {

inline std::int64_t clock_ns(clockid_t clock) {
  timespec now{};
  clock_gettime(clock, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

// The clock of all times in the server, ns.
inline std::int64_t monotonic_ns() {
  return clock_ns(CLOCK_MONOTONIC);
}

// Since 1970, ns: for people, and to compare machines.
inline std::int64_t unix_ns() {
  return clock_ns(CLOCK_REALTIME);
}

// What the calling thread has used, s.
inline double thread_cpu_s() {
  return 1e-9 * static_cast<double>(clock_ns(CLOCK_THREAD_CPUTIME_ID));
}

}  // namespace incise
