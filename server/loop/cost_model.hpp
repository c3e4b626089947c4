#pragma once

#include <algorithm>
#include <cstdint>

namespace incise::loop {

// What a unit of cutting work (core::WorkBudget) costs on this machine now: the one place where time becomes
// work. It only decides how far a frame gets, never what is done.
//
// A unit costs some 20 ns while a batch is searched and 600 while it is repaired, so with the average the heavy phases
// would overrun. A slice is sized by the cost that nine slices in ten do not exceed, or by the last one's if that was
// higher. The core stops only between two operations, and some take longer than a slice: from longest_ns() the loop knows
// whether another slice still fits into its frame.
//
// Thread: the loop's.
class CostModel {
 public:
  // The work that `ns` have room for, at least one unit.
  std::int64_t units_in(std::int64_t ns) const {
    const double cost = std::max(high_ns_, last_ns_);
    return std::max<std::int64_t>(1, static_cast<std::int64_t>(static_cast<double>(ns) / cost));
  }
  // How long even the smallest slice may take, ns: the longest of the last ones, at most kLongest_ns.
  std::int64_t longest_ns() const { return static_cast<std::int64_t>(longest_ns_); }

  // Learns from a slice of work. `whole`: it neither began nor ended a batch, which costs time but no units.
  void observe(std::int64_t units, std::int64_t ns, bool whole) {
    longest_ns_ = std::max(std::min(static_cast<double>(ns), kLongest_ns), kForget * longest_ns_);
    if (units <= 0 || ns <= 0) return;
    // One slice that was interrupted must not shorten those of the next frames for long.
    const double cost = std::clamp(static_cast<double>(ns) / static_cast<double>(units), kLeast_ns, kMost_ns);
    const double weight = std::min(1.0, static_cast<double>(units) / kMemory_units);
    average_ns_ += weight * (std::min(cost, 4 * average_ns_) - average_ns_);
    if (!whole) return;
    last_ns_ = std::min(cost, 4 * high_ns_);
    // Rises nine times as much where it was exceeded as it falls where it was not, so it settles where one in ten exceeds it
    // (Robbins and Monro 1951, "A stochastic approximation method", on a logarithmic scale).
    high_ns_ = std::clamp(high_ns_ * (cost > high_ns_ ? 1 + 9 * kStep : 1 - kStep), kLeast_ns, kMost_ns);
  }
  // On average.
  double ns_per_unit() const { return average_ns_; }

 private:
  static constexpr double kMemory_units = 20'000;
  static constexpr double kLeast_ns = 1, kMost_ns = 100'000;
  static constexpr double kStep = 0.01;
  static constexpr double kLongest_ns = 500'000, kForget = 0.9;
  // Until measured.
  double average_ns_ = 50, high_ns_ = 100, last_ns_ = 0;
  double longest_ns_ = 0;
};

}  // namespace incise::loop
