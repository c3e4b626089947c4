#pragma once

#include <algorithm>
#include <cstdint>

namespace incise::loop {

// What a unit of cutting work (core::WorkBudget) costs on this machine now: the one place where time becomes
// work. It only decides how far a frame gets, never what is done. An average that forgets: a slice of work
// weighs by its size against kMemory_units of past work.
//
// Thread: the loop's.
class CostModel {
 public:
  // The work that `ns` have room for, at least one unit.
  std::int64_t units_in(std::int64_t ns) const {
    return std::max<std::int64_t>(1, static_cast<std::int64_t>(static_cast<double>(ns) / ns_per_unit_));
  }
  // Learns from a slice of work.
  void observe(std::int64_t units, std::int64_t ns) {
    if (units <= 0 || ns <= 0) return;
    // One slice that was interrupted must not make the next frames timid for long.
    const double cost = std::clamp(static_cast<double>(ns) / static_cast<double>(units), kLeast_ns, kMost_ns);
    const double weight = std::min(1.0, static_cast<double>(units) / kMemory_units);
    ns_per_unit_ += weight * (std::min(cost, 4 * ns_per_unit_) - ns_per_unit_);
  }
  double ns_per_unit() const { return ns_per_unit_; }

 private:
  static constexpr double kMemory_units = 20'000;
  static constexpr double kLeast_ns = 1, kMost_ns = 100'000;
  double ns_per_unit_ = 50;  // until measured
};

}  // namespace incise::loop
