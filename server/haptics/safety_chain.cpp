#include "server/haptics/safety_chain.hpp"

#include <algorithm>
#include <cmath>

#include "server/base/check.hpp"

namespace incise::haptics {
namespace {

using core::Vec3;

constexpr double kLongestStep_s = 0.005;  // what a force may grow by after a late frame

double seconds(std::int64_t ns) {
  return static_cast<double>(ns) * 1e-9;
}

}  // namespace

SafetyChain::SafetyChain(const SafetyLimits& limits) : limits_(limits) {
  INCISE_CHECK(limits.most_n > 0 && limits.slew_n_s >= limits.most_n / limits.decay_s, limits.most_n,
               limits.slew_n_s, limits.decay_s);
}

void SafetyChain::arm(std::uint32_t losses, std::uint32_t failed_writes) noexcept {
  losses_ = losses;
  failed_writes_ = failed_writes;
  device_gone_ = false;
  latched_ = false;
  faults_ = 0;
  fault_count_ = 0;
  recent_ = 0;
  // What acts now fades as after a fault; then the ramp begins.
  begin_fade(last_ns_);
}

void SafetyChain::rearm_after_faults() noexcept {
  if (!latched_ || device_gone_) return;
  latched_ = false;
  recent_ = 0;
}

Vec3 SafetyChain::update(const SafetyInput& in) noexcept {
  const double dt = started_ ? std::max(0.0, seconds(in.now_ns - last_ns_)) : 0;
  const std::int64_t before_ns = started_ ? last_ns_ : in.now_ns;
  started_ = true;
  last_ns_ = in.now_ns;
  present_ = 0;
  const double most = in.device_most_n > 0 ? std::min(in.device_most_n, limits_.most_n) : limits_.most_n;

  const Vec3 computed = finite(in.wanted);
  const Vec3 clamped = clamp(computed, most);
  if (const std::uint32_t faults = look(in) | present_; faults != 0) note_fault(faults, before_ns, in.now_ns);
  const Vec3 slewed = fading_ ? slewed_ : slew(clamped, std::min(dt, kLongestStep_s));
  const Vec3 ramped = fading_ ? fade_from_ : ramp(slewed, std::min(dt, kLongestStep_s), in.contact);
  const Vec3 watched = watchdog(ramped, in.now_ns);
  acting_ = latch(watched);
  limited_ = squared_length(computed - acting_) > 1e-12;
  return acting_;
}

// What is wrong in this frame, apart from the force itself.
std::uint32_t SafetyChain::look(const SafetyInput& in) noexcept {
  std::uint32_t faults = 0;
  if (in.losses != losses_) faults |= kDeviceLost;
  if (in.failed_writes != failed_writes_) faults |= kWriteFailed;
  losses_ = in.losses;
  failed_writes_ = in.failed_writes;
  if (seconds(in.now_ns - in.pose_ns) > limits_.silence_s) faults |= kSilent;
  if (seconds(in.now_ns - in.moved_ns) > limits_.frozen_s) faults |= kFrozen;
  if (seconds(in.late_ns) > limits_.late_s()) faults |= kLate;
  return faults;
}

void SafetyChain::begin_fade(std::int64_t from_ns) noexcept {
  fading_ = true;
  fade_begin_ns_ = from_ns;
  fade_from_ = acting_;
}

// `before_ns`: the frame before, up to which the force that acts was right.
void SafetyChain::note_fault(std::uint32_t faults, std::int64_t before_ns, std::int64_t now_ns) noexcept {
  const bool acts = squared_length(acting_) > 0;
  const bool device = (faults & (kDeviceLost | kWriteFailed)) != 0;
  present_ = faults;
  // A device that rests without a force does no harm: no new ramp is needed.
  if (!acts && !fading_ && faults == kFrozen) {
    present_ = 0;
    return;
  }
  const bool counts = acts || device || (faults & kNotFinite) != 0;
  if (!fading_) {
    begin_fade(before_ns);
    if (counts) {
      if (seconds(now_ns - recent_ns_) > limits_.fault_memory_s || recent_ == 0) {
        recent_ = 0;
        recent_ns_ = now_ns;
      }
      ++fault_count_;
      if (++recent_ >= limits_.most_faults) latched_ = true;
    }
  }
  if (counts) faults_ |= faults;
  if (device) latched_ = device_gone_ = true;
}

// ------------------------------------------------------------------------------------------------ the stages

Vec3 SafetyChain::finite(const Vec3& f) noexcept {
  if (is_finite(f)) return f;
  present_ |= kNotFinite;
  return {};
}

Vec3 SafetyChain::clamp(const Vec3& f, double most) const noexcept {
  // By the largest component first: the square of a huge one is infinite.
  const double largest = std::max({std::abs(f.x), std::abs(f.y), std::abs(f.z)});
  if (largest == 0) return f;
  const Vec3 scaled = (1 / largest) * f;
  const double magnitude = largest * length(scaled);
  return magnitude > most ? (most / length(scaled)) * scaled : f;
}

Vec3 SafetyChain::slew(const Vec3& f, double dt_s) noexcept {
  const double of_ramp = limits_.ramp_s > 0 ? limits_.most_n / limits_.ramp_s : 0;
  const double most = (limits_.slew_n_s - of_ramp) * dt_s;
  const Vec3 change = f - slewed_;
  const double size = length(change);
  slewed_ = size > most ? slewed_ + (most / size) * change : f;
  return slewed_;
}

Vec3 SafetyChain::ramp(const Vec3& f, double dt_s, bool contact) noexcept {
  if (limits_.ramp_s == 0) {
    ramp_ = 1;
  } else if (touched_) {
    ramp_ = std::min(1.0, ramp_ + dt_s / limits_.ramp_s);
  }
  touched_ = touched_ || contact;
  return ramp_ * f;
}

Vec3 SafetyChain::watchdog(const Vec3& f, std::int64_t now_ns) noexcept {
  if (!fading_) return f;
  const double left = 1 - seconds(now_ns - fade_begin_ns_) / limits_.decay_s;
  if (left > 0 && squared_length(fade_from_) > 0) return left * f;
  fade_from_ = slewed_ = {};
  ramp_ = 0;
  touched_ = false;
  if (present_ == 0 && !latched_) fading_ = false;
  return {};
}

Vec3 SafetyChain::latch(const Vec3& f) const noexcept {
  // The fade that leads to it is the watchdog's.
  return latched_ && !fading_ ? Vec3{} : f;
}

}  // namespace incise::haptics
