#pragma once

#include <cstdint>
#include <mutex>
#include <optional>

#include "protocol/messages.hpp"

namespace incise::client {

// What may be asked of the device at this end.
struct ContactLimits {
  double most_n = 3.3;    // magnitude
  double slew_n_s = 500;  // change in a second; above most_n / ramp_s, the part that the ramp takes
  // From nothing to full force at the first contact, after a contact that expired in use, and after a silence. 0: at once.
  double ramp_s = 2;
  double stiffest_n_m = 2000;
  double most_torque_n_m = 0.2;  // its change is limited in the same proportion to slew_n_s
};

// What acts on the hand, world frame: N, and N m about the tool's origin.
struct Wrench {
  protocol::Vec3 force_n, torque_n_m;
};

// Renders the tissue near the blade at the device's own rate, from the planes that the server sends (Force.contact,
// PROTOCOL.md section 7), however old they are. No force is NaN, exceeds the limits, or starts without the ramp; when
// its plane expires it fades at the slew limit.
//
// Call it at 500 Hz and more. After a silence of its own, kSilence_ns without a call (a thread that was paused), the
// next call gives no force, and the ramp begins again: what the device did meanwhile is not known here.
//
// Delay cannot make it unstable: a plane is a spring, a damper and friction, and what they give back is bounded by an
// account of the work that the tool has done on them here. A plane that comes late or jumps may promise more; its
// elastic force is then scaled down to what is in the account (after Hannaford and Ryu 2002, "Time-domain passivity
// control of haptic interfaces"). In t seconds no more than kReserve_j + kLeak_w t comes out than went in, except for
// the work of one step and of the fade.
//
// Thread: take() from one (the client's), force() or wrench() from one (the device's), at the same time if need be.
class ContactRenderer {
 public:
  static constexpr double kReserve_j = 5e-4;
  static constexpr double kLeak_w = 0.01;
  static constexpr std::int64_t kSilence_ns = 50'000'000;

  // Throws std::invalid_argument: a limit that is no finite number from 0, or a slew limit that the ramp uses up.
  explicit ContactRenderer(const ContactLimits& limits = {});

  // Takes over a message that arrived at `now_ns`, by a clock of this machine. For Callbacks::on_force.
  void take(const protocol::Force& force, std::int64_t now_ns);

  // The force on the hand, N, world frame, for the tool's origin at `tool_m` now. Apply it until the next call. With a
  // tool that is not finite, or more than 10 km away, it fades. `now_ns` is of the same clock and must rise. Allocates
  // nothing; waits at most while take() copies a plane.
  protocol::Vec3 force(const protocol::Vec3& tool_m, std::int64_t now_ns);
  // The same for a device that makes torques: force, and torque about the tool's origin, N m. The force acts where the
  // tissue presses on the blade (LocalContact::arm), and turning the tool is work that is booked, too. `orientation` is
  // the unit quaternion world_from_tool; one that is not finite or far from unit is passed over. Use one of the two
  // throughout.
  Wrench wrench(const protocol::Vec3& tool_m, const protocol::Quat& orientation, std::int64_t now_ns);

 private:
  struct Plane {
    protocol::LocalContact contact;
    std::int64_t until_ns = 0;
    bool over = true;  // the server said that there is no tissue; otherwise it has expired
    std::uint64_t number = 0;
  };
  double growing_s(std::int64_t now_ns) const;
  void begin_again();

  const ContactLimits limits_;
  std::mutex mutex_;
  Plane newest_;  // guarded by mutex_
  // The device's thread's.
  Plane plane_;
  bool called_ = false, begun_ = false;     // at all; with a place that is a number
  std::int64_t last_ns_ = 0, tool_ns_ = 0;  // of those calls
  protocol::Vec3 last_tool_, velocity_, applied_, slewed_, torque_;
  std::optional<protocol::Quat> orientation_;
  double account_ = kReserve_j;
  double ramp_ = 0;
};

}  // namespace incise::client
