#pragma once

// A motion that cuts for as long as one likes.

#include <cmath>
#include <cstdint>

#include "server/core/stroke/blade.hpp"

namespace incise::tests {

// A blade that hangs down through a body, given by its bounding box, and goes to and fro across it along y, each pass
// a little further along x: engaged while inside, lifted beyond. Times are source times from 1 on.
class ToAndFro {
 public:
  ToAndFro(const core::Vec3& low, const core::Vec3& high, double speed_m_s, double rate_hz)
      : low_(low), high_(high), step_m_(speed_m_s / rate_hz), rate_hz_(rate_hz) {}

  core::Pose next() {
    const double margin = 0.1 * (high_.y - low_.y), width = high_.y - low_.y + 2 * margin;
    const double travelled = step_m_ * static_cast<double>(count_);
    const double pass = std::floor(travelled / width), within = travelled - pass * width;
    const bool back = std::fmod(pass, 2) == 1;
    core::Pose pose;
    pose.t_ns = static_cast<std::int64_t>(1e9 / rate_hz_ * static_cast<double>(++count_));
    const double along = std::fmod(0.1 + 0.03819 * pass, 0.8) + 0.1;
    pose.position = {low_.x + along * (high_.x - low_.x),
                     back ? high_.y + margin - within : low_.y - margin + within, high_.z + 0.01};
    // Lifted while it moves along the body.
    pose.buttons = within > 2 * step_m_ && within < width - 2 * step_m_ ? 1 : 0;
    return pose;
  }
  core::Blade blade() const { return {{0, 0, 0}, {0, 0, -(high_.z - low_.z + 0.02)}}; }

 private:
  core::Vec3 low_, high_;
  double step_m_, rate_hz_;
  std::uint64_t count_ = 0;
};

}  // namespace incise::tests
