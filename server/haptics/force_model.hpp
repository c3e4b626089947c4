#pragma once

#include <cmath>
#include <cstdint>
#include <optional>

#include "server/core/stroke/blade.hpp"
#include "server/haptics/blade_probe.hpp"
#include "server/haptics/material.hpp"
#include "server/haptics/simulation_link.hpp"
#include "server/haptics/tissue.hpp"

namespace incise::haptics {

// Where a blade is in one frame.
struct BladeMotion {
  core::BladeLine line;
  core::Vec3 tool;       // the tool's origin, where a device applies the force, m
  bool engaged = false;  // it cuts
  double dt_s = 0;  // since the pose before, by the source's clock; 0: this pose is the one of the last call
  double elapsed_s = 0;    // since the last call, by ours
  core::Quat orientation;  // of the tool
  core::Vec3
      torque;  // that acted on the hand since the last call, about the tool's origin, N m; zero: its device makes none
  bool ramping = false;  // the hand gets less than the tissue's force, for a moment
};

// The tissue near the blade as a plane, for clients that render at their own rate (protocol::LocalContact).
struct ContactPlane {
  core::Vec3 point;   // the tool's origin when the force begins, m
  core::Vec3 normal;  // unit, out of the tissue
  double stiffness_n_m = 0;
  double damping_n_s_m = 0;   // along the normal
  double resistance_n = 0;    // at which the tissue gives way; 0: it does not
  double friction_n_s_m = 0;  // against the motion: across the normal; in all directions once the blade is in
  bool penetrated = false;
};

struct Feel {
  core::Vec3 force;  // on the hand, at the tool's origin, N
  core::Vec3
      arm;  // from the tool's origin to the middle of the edge's longest stretch inside, m: torque = arm x force
  Engagement engagement;
  std::optional<ContactPlane> contact;  // absent: no tissue at the blade
  ProbeWork work;                       // that it took
};

// The force of the tissue on one blade, frame by frame. A spring joins the blade to a proxy, which the tissue holds:
// the virtual coupling of Colgate, Stanley and Brown 1995, "Issues in the haptic display of tool use".
//
//   free      nothing of the edge is inside.
//   contact   the proxy stays on the surface, at the point nearest to the deepest point of the edge: elastic force
//             and damping along its normal, friction across. While the blade is engaged the surface holds up to
//             max(puncture, toughness x edge inside); a blade that is not engaged never gets in.
//   inside    the proxy is the front of the cut. Ahead of it the spring holds up to toughness x length of edge in
//             uncut tissue, across the edge; beyond that the front moves along and that much work is spent for each
//             area that the edge sweeps (the deformation and cutting phases of Mahvash and Hayward 2001, "Haptic
//             rendering of cutting: a fracture mechanics approach"). Behind the front the blade is in its own slit
//             and feels friction alone, as it does where the mesh is cut already. A motion along the edge sweeps no
//             area and feels friction alone, too.
//
// Deformed tissue. The edge is taken back to the body at rest (RestMap), where penetration, cuts and the front are
// what they are in tissue that does not move; depths, normals and steps come forward again with the deformation gradient F.
// The blade's velocity is relative to the tissue: F times that of the material that the edge's middle passes, so tissue that moves
// drags the hand along, and a body that moves with the blade is felt as one at rest.
//
// Passivity. Sampling makes even a spring give back more than it took (Colgate and Schenkel 1997, "Passivity of a
// class of sampled-data systems"), and turning the tool stretches it without any work on a device that does not feel
// torques; where a device makes them, torque times turn is booked, too. So what the model gives is bounded by an account of what it got through the tool's origin (after Hannaford
// and Ryu 2002, "Time-domain passivity control of haptic interfaces"): the elastic force is scaled so that it can
// return no more than the account holds, and friction stops with the account. The account never holds more than
// the spring does at full force and kReserve_j: work spent on cutting does not come back. It grows by kLeak_w on its
// own, so that tissue entered by turning is felt after a moment; hand and device damp more than that.
// Whatever the motion, the energy that comes out in t seconds, less what went in, is at most
// kReserve_j + kLeak_w t + the work of a single step.
// Tissue that gives way takes a part of that energy along, and gives it back when it returns. What it took is booked in
// a second account, and tissue that moves by itself (a heart) has kTissueReserve_j there, which comes back at kTissueLeak_w. So in
// tissue that deforms, with a simulation that may be late or wrong, the bound is kReserve_j + kTissueReserve_j +
// (kLeak_w + kTissueLeak_w) t.
//
// Thread: one. update() costs the way back to rest, the probe and, in contact, up to seven searches for the surface, all within the bounds of
// ProbeWork; it allocates nothing.
class ForceModel {
 public:
  static constexpr double kReserve_j = 5e-4;
  static constexpr double kLeak_w = 0.01;
  static constexpr double kTissueReserve_j = 5e-3;
  static constexpr double kTissueLeak_w = 0.02;

  // The spring is never stiffer than `stiffest`, N/m, nor damped by more than `damping` along the normal, N s/m: what a
  // device can render without trembling. `materials` must outlive this.
  // `resists`: a blade that has been withdrawn to half the depth at which the surface gave way presses on it again.
  ForceModel(const Materials& materials, double stiffest_n_m, double damping_n_s_m, bool resists = false);

  // The blade is somewhere else, not moved there: everything but the account is forgotten.
  void jump() noexcept;

  // The force from here on. `applied`: what acted on the hand since the last call, N. `own`: the simulation's model of the tissue,
  // which then makes the force; its work counts as the tissue's, so it gives back what it got, and nothing that it did not.
  Feel update(const Tissue& tissue, const BladeMotion& motion, const core::Vec3& applied,
              const LocalModel* own = nullptr) noexcept;
  // Whether the tissue has yielded to the blade: it is inside, and not held by the surface.
  bool inside() const { return phase_ == Phase::kInside; }
  // The edge of the last update at rest.
  const RestLine& line() const { return line_; }

 private:
  enum class Phase : std::uint8_t { kFree, kContact, kInside };
  struct Elastic {
    core::Vec3 force;
    double energy = 0;  // that the spring can give back
  };
  // Of the edge's parameter `at`, since the last call, m: of the blade, and of it relative to the tissue.
  core::Vec3 step(const BladeMotion& motion, double at) const noexcept;
  core::Vec3 relative_step(double at) const noexcept;
  double moved_at_rest() const noexcept;
  void book(const BladeMotion& motion, const core::Vec3& applied) noexcept;
  void book_tissue(const BladeMotion& motion, double at, const core::Vec3& applied) noexcept;
  void book_tissue(const BladeMotion& motion, const Elastic& spring) noexcept;
  void take_from_tissue(double energy) noexcept;
  double covered(double energy) const noexcept;
  void find_velocity(const BladeMotion& motion, double at) noexcept;
  void find_depth(const Tissue& tissue, const BladeMotion& motion, double moved, Feel& feel) noexcept;
  void find_hold(const BladeMotion& motion, const Engagement& engagement) noexcept;
  Elastic spring(const Engagement& engagement) const noexcept;
  Elastic press(const BladeMotion& motion, const Engagement& engagement, const Elastic& spring,
                const core::Vec3& applied, Feel& feel) noexcept;
  Elastic cut(const BladeMotion& motion, const Engagement& engagement, double h, Feel& feel) noexcept;
  bool withdrawn(const Tissue& tissue, const Engagement& engagement, ProbeWork& work) const noexcept;
  Elastic render(const LocalModel& own, const BladeMotion& motion, Feel& feel) noexcept;
  void get_in(const core::Vec3& along, const Engagement& engagement) noexcept;

  const Materials& materials_;
  const double stiffest_, damping_;
  const bool resists_;
  Phase phase_ = Phase::kFree;
  bool has_last_ = false;
  core::BladeLine last_line_;
  core::Vec3 last_tool_;
  core::Quat last_orientation_;
  core::Vec3 velocity_;  // of the edge where it is inside, relative to the tissue, m/s
  double account_ = kReserve_j, tissue_account_ = kTissueReserve_j;
  core::Vec3 last_elastic_;  // the spring's part of the last force, N
  // The edge at rest: now, and in the call before.
  RestLine line_, before_;
  LocalMap map_;  // of the tissue at the middle of the edge inside
  // The simulation's model.
  std::uint64_t own_number_ = 0;
  bool own_acts_ = false;
  core::Vec3 own_point_;      // which gives way
  core::Vec3 tool_velocity_;  // m/s
  // Contact.
  double depth_ = 0, depth_at_rest_ = 0;  // m: now, and in the body at rest
  core::Vec3 normal_;                     // unit, out of the tissue
  double holds_n_ = INFINITY;             // the surface
  double yields_at_n_ = INFINITY;  // what it held when the spring first pulled as hard; infinite: it does not
  double yields_s_ = 0;            // for how long the spring has pulled as hard as the surface holds
  // Inside.
  double yielded_at_ = 0;     // depth at which the surface gave way, in the body at rest, m; 0: it did not
  core::Vec3 front_;          // a point of the front's line, in the body at rest
  core::Vec3 front_heading_;  // where it last moved to, in the body at rest; zero: it has not
};

}  // namespace incise::haptics
