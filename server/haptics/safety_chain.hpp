#pragma once

#include <cstdint>

#include "server/core/geometry/vec3.hpp"

namespace incise::haptics {

// What a force may do, whatever was computed.
struct SafetyLimits {
  double most_n = 3.3;      // magnitude
  double slew_n_s = 500;    // change of the force vector in a second; at least most_n / decay_s
  double ramp_s = 2;        // from nothing to full, at the first contact and after a fault; 0: at once
  double silence_s = 0.02;  // without a pose: the source is silent
  double frozen_s = 0.25;   // poses that repeat each other to the bit while a force acts: the device is stuck
  double decay_s = 0.01;    // from any force to 0 after a fault
  int most_faults = 3;      // so many within fault_memory_s latch the force off
  double fault_memory_s = 60;

  double late_s() const { return 0.25 * silence_s; }  // a frame that begins so late counts as a fault
};

// What was wrong, as a set of bits.
enum SafetyFault : std::uint32_t {
  kNotFinite = 1,     // the computed force was NaN or infinite
  kSilent = 2,        // no pose for a while, with a force acting
  kFrozen = 4,        // poses repeat each other, with a force acting
  kLate = 8,          // the loop was late, with a force acting
  kDeviceLost = 16,   // latches at once
  kWriteFailed = 32,  // latches at once
};

// What the chain looks at in one frame. Times are CLOCK_MONOTONIC, ns.
struct SafetyInput {
  std::int64_t now_ns = 0;
  core::Vec3 wanted;          // N, as computed
  bool contact = false;       // tissue at the blade
  std::int64_t pose_ns = 0;   // arrival of the newest pose that was accepted
  std::int64_t moved_ns = 0;  // arrival of the newest pose that differs from the one before
  std::int64_t late_ns = 0;   // how late the frame began
  double device_most_n = 0;   // what the device can make; 0: it does not say
  std::uint32_t losses = 0;   // of the device so far, as ForceSlot counts them
  std::uint32_t failed_writes = 0;
};

// The last thing that a force passes. Six stages, always in this order:
//
//   1 finite    NaN and infinity become 0, and are a fault.
//   2 clamp     the magnitude stays within the limit (the smaller of ours and the device's).
//   3 slew      the vector changes by no more than so much in a second. A part of that, most_n / ramp_s, is left for
//               the ramp, so that the two together keep to it.
//   4 ramp      grows from 0 to 1 in ramp_s from the first contact on, again after any fault.
//   5 watchdog  after a fault the force that acted fades linearly to 0 within decay_s; only then, and only when the
//               fault has gone, does it begin again with the ramp.
//   6 latch     device lost, write failed, or three faults in a minute: 0 until armed again.
//
// So for any input: |force| <= limit, |change| <= slew_n_s x time, a fault is followed by 0 within decay_s, and the
// force after a fault is at most limit x time / ramp_s.
//
// Silence, a frozen device and a late frame count as faults only while a force acts; else they merely restart the
// ramp. Pure: time is passed in. Thread: one.
class SafetyChain {
 public:
  explicit SafetyChain(const SafetyLimits& limits);

  // Lets forces begin, with the ramp: a source was opened, or its user asks for it after a latch. Only later `losses` and
  // `failed_writes` of the device count as faults.
  void arm(std::uint32_t losses, std::uint32_t failed_writes) noexcept;
  // The user's wish to go on after three faults: the engage button pressed again, outside the tissue. Has no effect after
  // the loss of a device or a failed write: then the source must be opened again.
  void rearm_after_faults() noexcept;

  // The force that may act from here on, N. Time must not fall; O(1).
  core::Vec3 update(const SafetyInput& in) noexcept;

  bool latched() const { return latched_; }
  bool ramping() const { return ramp_ < 1; }
  // Whether a stage made the last force smaller than what was computed.
  bool limited() const { return limited_; }
  // All faults since arm(), and how many there were.
  std::uint32_t faults() const { return faults_; }
  std::uint64_t fault_count() const { return fault_count_; }

 private:
  core::Vec3 finite(const core::Vec3& f) noexcept;
  core::Vec3 clamp(const core::Vec3& f, double most) const noexcept;
  core::Vec3 slew(const core::Vec3& f, double dt_s) noexcept;
  core::Vec3 ramp(const core::Vec3& f, double dt_s, bool contact) noexcept;
  core::Vec3 watchdog(const core::Vec3& f, std::int64_t now_ns) noexcept;
  core::Vec3 latch(const core::Vec3& f) const noexcept;
  std::uint32_t look(const SafetyInput& in) noexcept;
  void note_fault(std::uint32_t faults, std::int64_t before_ns, std::int64_t now_ns) noexcept;
  void begin_fade(std::int64_t from_ns) noexcept;

  const SafetyLimits limits_;
  bool started_ = false;
  std::int64_t last_ns_ = 0;
  std::uint32_t losses_ = 0, failed_writes_ = 0;
  core::Vec3 slewed_;          // after stage 3
  double ramp_ = 0;            // 0 to 1
  bool touched_ = false;       // the ramp has begun
  core::Vec3 acting_;          // the last result
  std::uint32_t present_ = 0;  // faults of this frame
  bool fading_ = false;
  std::int64_t fade_begin_ns_ = 0;
  core::Vec3 fade_from_;
  bool latched_ = false, device_gone_ = false;
  bool limited_ = false;
  std::uint32_t faults_ = 0;
  std::uint64_t fault_count_ = 0;
  int recent_ = 0;  // faults within the memory, counted from recent_ns_ on
  std::int64_t recent_ns_ = 0;
};

}  // namespace incise::haptics
