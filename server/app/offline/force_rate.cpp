#include "server/app/offline/force_rate.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "server/app/offline/motion_run.hpp"
#include "server/core/stroke/jump.hpp"

namespace incise::app {
namespace {

using core::Pose;
using core::Quat;

constexpr std::uint64_t kPeriod_ns = 1'000'000;
constexpr std::uint64_t kMaxAdded = 1'000'000;  // which bounds memory where times are seconds of years

// Along the shorter arc. Both are of about unit length; `u` from 0 to 1.
Quat slerp(const Quat& a, Quat b, double u) {
  double cosine = a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z;
  if (cosine < 0) {
    b = {-b.w, -b.x, -b.y, -b.z};
    cosine = -cosine;
  }
  double of_a = 1 - u, of_b = u;
  if (cosine < 0.9999) {  // below that angle the chord is the arc
    const double angle = std::acos(cosine);
    of_a = std::sin((1 - u) * angle) / std::sin(angle);
    of_b = std::sin(u * angle) / std::sin(angle);
  }
  const Quat q{of_a * a.w + of_b * b.w, of_a * a.x + of_b * b.x, of_a * a.y + of_b * b.y,
               of_a * a.z + of_b * b.z};
  const double norm = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
  return {q.w / norm, q.x / norm, q.y / norm, q.z / norm};
}

}  // namespace

std::size_t interpolate_to_force_rate(CutInput& input) {
  std::vector<MotionEvent>& events = input.motion.events;
  if (input.motion.header || events.empty()) return 0;
  const core::Blade blade = blade_of(input.config, events.front().source);
  const Pose &first = events.front().pose, &last = events.back().pose;
  const std::uint64_t period_ns =
      last.t_ns <= first.t_ns ? kPeriod_ns : std::max(kPeriod_ns, elapsed_ns(first, last) / kMaxAdded);
  std::vector<MotionEvent> all;
  all.reserve(events.size());
  for (const MotionEvent& event : events) {
    if (!all.empty() && event.pose.t_ns > all.back().pose.t_ns) {
      const Pose a = all.back().pose;
      const Pose& b = event.pose;
      const std::uint64_t dt_ns = elapsed_ns(a, b);
      const std::uint64_t parts = (dt_ns + period_ns / 2) / period_ns;
      if (parts > 1 && !is_jump(input.config.cut, blade, a, b)) {
        for (std::uint64_t k = 1; k < parts; ++k) {
          const double u = static_cast<double>(k) / static_cast<double>(parts);
          MotionEvent between = event;
          between.pose.t_ns = a.t_ns + static_cast<std::int64_t>(u * static_cast<double>(dt_ns));
          between.arrival_ns = between.pose.t_ns;
          between.pose.position = a.position + u * (b.position - a.position);
          between.pose.orientation = slerp(a.orientation, b.orientation, u);
          between.pose.buttons = a.buttons & b.buttons;
          all.push_back(between);
        }
      }
    }
    all.push_back(event);
  }
  const std::size_t added = all.size() - events.size();
  events = std::move(all);
  return added;
}

}  // namespace incise::app
