#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "server/app/offline/motion_input.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/haptics/force_stage.hpp"

namespace incise::app {

// What a blade felt at one pose.
struct FeltPose {
  std::uint32_t source = 0;
  std::int64_t time_ns = 0;    // since the motion's first pose, on one clock for all sources
  std::int64_t pose_t_ns = 0;  // the pose's own time
  core::Vec3 position;         // of the tool's origin, m
  core::Vec3 hand;             // on the hand, after the safety chain, N
  core::Vec3 tissue;           // what the force model computed, N
  // How far the tissue's spring is stretched, m: the depth under the surface until the blade is in, then how far it is ahead
  // of the cut's front (negative: behind it, in its own slit).
  double depth_m = 0;
  haptics::Engagement edge;
  double resistance_n = 0;  // at which the tissue gives way; 0: the blade does not cut
  bool contact = false, inside = false, engaged = false, limited = false, latched = false;
  bool jumped = false;  // it did not move here from the pose before
  bool entered =
      false;  // it moved from the surface, or from outside, into tissue that was not cut: a puncture
  std::uint32_t faults = 0;  // haptics::SafetyFault so far
};

// The force on each blade of a recorded motion, as the server's loop computes it, with the same ForceStage: in a frame for each
// pose, at the pose's own time, with the cuts of all frames before; then what the pose completes is cut. Two things differ:
// there is no frame between poses, so nothing is late, and a single source never silent; and forces do not ramp up at the
// first contact.
//
// Deterministic: no clock is read.
class FeelRun final : private haptics::ForceSink {
 public:
  // `input` must outlive this.
  explicit FeelRun(const CutInput& input, std::string motion_name);

  void run(Progress& progress);

  // In the order of the motion; rejected poses are left out.
  const std::vector<FeltPose>& poses() const { return poses_; }
  // Where the blades' edges were.
  const Box& reach() const { return reach_; }
  // Poses rejected, jumps, units; and, without any contact, that.
  std::vector<std::string> warnings() const;
  bool touched() const;

 private:
  // A source's time on the common clock.
  struct Clock {
    bool runs = false;
    std::int64_t first_t_ns = 0, start_ns = 0;
  };
  void feel(const haptics::BladeForce& force) noexcept override;
  void handle(const MotionEvent& event, core::PoseVerdict verdict);
  void open(std::uint32_t source, const core::Blade& blade);
  void advance_clock(const MotionEvent& event);
  std::string why_no_contact() const;

  const CutInput& input_;
  core::CutSession session_;
  haptics::ForceStage stage_;
  MotionRun motion_run_;
  std::array<std::optional<core::Blade>, core::kMaxSources> blades_;
  std::array<Clock, core::kMaxSources> clocks_;
  std::array<std::optional<bool>, core::kMaxSources> was_inside_;  // at its last pose
  std::optional<std::int64_t> first_arrival_ns_;
  std::int64_t now_ns_ = 0;
  const MotionEvent* current_ = nullptr;              // whose frame runs
  std::optional<haptics::BladeForce> current_force_;  // for it; nothing in air
  std::vector<FeltPose> poses_;
  Box reach_;
};

}  // namespace incise::app
