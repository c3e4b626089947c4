#pragma once

#include <algorithm>
#include <cstdint>

namespace incise::loop {

// A part of the time of all frames. What a frame uses of it comes back as time goes by, so that many short frames get no more than one long one.
class FrameShare {
 public:
  FrameShare(double fraction, std::int64_t period_ns)
      : fraction_(fraction), whole_ns_(part_of(period_ns)), left_ns_(whole_ns_) {}

  // Of a frame.
  std::int64_t whole_ns() const { return whole_ns_; }
  std::int64_t left_ns() const { return left_ns_; }
  void pass(std::int64_t elapsed_ns) { left_ns_ = std::min(whole_ns_, left_ns_ + part_of(elapsed_ns)); }
  void use(std::int64_t used_ns) { left_ns_ = std::max<std::int64_t>(0, left_ns_ - used_ns); }

 private:
  std::int64_t part_of(std::int64_t time_ns) const {
    return static_cast<std::int64_t>(fraction_ * static_cast<double>(time_ns));
  }

  const double fraction_;
  const std::int64_t whole_ns_;
  std::int64_t left_ns_;
};

}  // namespace incise::loop
