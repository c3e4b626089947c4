#pragma once

#include <cstdint>
#include <mutex>

#include "protocol/messages.hpp"

namespace incise::client {

// What a device at this end may be asked for.
struct ContactLimits {
  double most_n = 3.3;    // magnitude
  double slew_n_s = 500;  // change in a second
  double ramp_s = 2;  // from nothing to full at the first contact, and after a contact that ran out in use
  double stiffest_n_m = 2000;
};

// Renders the tissue near the blade at the device's own rate, from the planes that the server sends (Force.contact,
// PROTOCOL.md section 7), however old they are. No force is NaN, beyond the limits, or there without the ramp; one
// whose plane has expired fades at the slew limit.
//
// Delay cannot make it unstable: a plane is only ever a spring, a damper and friction, and what they give back is
// bounded by an account of the work that the tool has done on them here. A plane that comes late, or jumps, may
// promise more than that; its elastic force is then scaled down to what is in the account (after Hannaford and Ryu 2002,
// "Time-domain passivity control of haptic interfaces"). In t seconds no more than kReserve_j + kLeak_w t comes out
// than went in, but for the work of one step and of the fade.
//
// Thread: take() from one (the client's), force() from one (the device's), at the same time if need be.
class ContactRenderer {
 public:
  static constexpr double kReserve_j = 5e-4;
  static constexpr double kLeak_w = 0.01;

  explicit ContactRenderer(const ContactLimits& limits = {}) : limits_(limits) {}

  // A message that came at `now_ns`, a clock of this machine's. From Callbacks::on_force.
  void take(const protocol::Force& force, std::int64_t now_ns);

  // The force on the hand, N, world frame, for the tool's origin there and then: to be applied until the next call. Same
  // clock; it must rise. Allocates nothing; waits for take() at most while it copies a plane.
  protocol::Vec3 force(const protocol::Vec3& tool_m, std::int64_t now_ns);

 private:
  struct Plane {
    protocol::LocalContact contact;
    std::int64_t until_ns = 0;
    bool over = true;  // the server says that there is no tissue; else it runs out
    std::uint64_t number = 0;
  };
  const ContactLimits limits_;
  std::mutex mutex_;
  Plane newest_;  // guarded by mutex_
  // The device's thread's.
  Plane plane_;
  bool begun_ = false;
  std::int64_t last_ns_ = 0;
  protocol::Vec3 last_tool_, velocity_, applied_, slewed_;
  double account_ = kReserve_j;
  double ramp_ = 0;
};

}  // namespace incise::client
