#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "server/core/cut/cut_config.hpp"
#include "server/core/mesh/delta.hpp"
#include "server/haptics/force_config.hpp"
#include "server/haptics/force_model.hpp"
#include "server/haptics/force_slot.hpp"
#include "server/haptics/safety_chain.hpp"
#include "server/haptics/tissue.hpp"

namespace incise::haptics {

// The force on a blade from one frame on.
struct BladeForce {
  std::uint32_t source = 0;
  std::int64_t pose_t_ns = 0;        // source time of the pose that it belongs to
  std::int64_t pose_arrival_ns = 0;  // CLOCK_MONOTONIC
  core::Vec3 newtons;                // on the hand at the tool's origin, world frame
  core::Vec3 newton_metres;          // likewise, about the tool's origin
  std::uint32_t flags = 0;           // ForceFlag
  std::uint32_t faults = 0;          // SafetyFault: since the source was opened
  bool jumped = false;               // the blade was elsewhere before: it did not move here
  Feel feel;                         // what the safety chain was given, and the tissue at the blade
};

// Takes the forces for operators on the network. Called on the loop's thread: must not block or allocate.
class ForceSink {
 public:
  virtual ~ForceSink() = default;
  virtual void feel(const BladeForce& force) noexcept = 0;
};

// The forces of all blades, once a frame: newest pose -> force model -> safety chain -> the source's slot and the sink.
// The sink gets a force for each new pose while there is tissue at the blade or a force acts, and one more when that
// ends; the slot gets one in every frame,
// until the source has been silent for a second.
//
// Thread: the loop's. frame() does at most ProbeWork's bounds for each blade, whatever has been cut, and allocates nothing.
class ForceStage {
 public:
  // `tissue` knows all cuts so far. `sink` and `slots` may be null; otherwise they must outlive this.
  ForceStage(const ForceConfig& config, const core::CutConfig& cut, std::unique_ptr<Tissue> tissue,
             ForceSink* sink, ForceSlots* slots);

  // What the loop took: a source opened (its force is armed), a pose that was accepted.
  void opened(std::uint32_t source, const core::Blade& blade) noexcept;
  void posed(std::uint32_t source, const core::Pose& pose, std::int64_t arrival_ns, bool jumped) noexcept;
  // Whether the tissue holds this blade's edge back, though it is engaged (ForceConfig::resists): by the forces of the last frame.
  bool holds_back(std::uint32_t source, const core::Pose& pose) const noexcept {
    return config_.resists && cut_.engages(pose.buttons) && !hands_[source]->yielded;
  }
  // Adds the cuts of a delta, which `mesh` has already. O(delta's boundary).
  void cut(const core::TetMesh& mesh, const core::Delta& delta) noexcept;
  // Adds cuts that a mesh has which was cut elsewhere: those of the faces that are cut faces. O(faces).
  void note_cuts(const core::TetMesh& mesh, std::span<const core::HalfFace> faces) noexcept;
  // The body is whole again.
  void restart() noexcept;
  // The mesh that is cut, for where the tissue is now, if it deforms; it must outlive this or the next call.
  void follow(const core::TetMesh& mesh, std::uint64_t revision) noexcept {
    tissue_->follow(mesh);
    revision_ = revision;
  }
  // Tells a host simulation what blades do to the body, and takes its own models of it; it must outlive this.
  void join(SimulationLink& link) noexcept { link_ = &link; }

  void frame(std::int64_t now_ns, std::int64_t late_ns) noexcept;

  // What acts on this hand since the last frame, N; world frame.
  const core::Vec3& acting(std::uint32_t source) const { return hands_[source]->acting; }
  // Arrival times of the poses that got their first force in the last frame: at most one for each blade.
  std::span<const std::int64_t> felt_ns() const { return std::span(felt_ns_).first(felt_count_); }
  // Forces whose edge was not searched to its end, because a bound of ProbeWork was reached.
  std::uint64_t cut_short() const { return cut_short_; }

 private:
  struct Hand {
    Hand(const Materials& materials, const ForceConfig& config)
        : model(materials, config.stiffest_n_m, config.damping_n_s_m, config.resists),
          chain(config.limits),
          torque_chain(config.torque_limits()) {}
    ForceModel model;
    SafetyChain chain, torque_chain;
    core::Blade blade;
    core::Pose pose, felt;  // the newest; the one that the last frame took
    std::int64_t arrival_ns = 0, moved_ns = 0, last_frame_ns = 0;
    bool opened = false, has_pose = false, has_felt = false, jumped = false;
    bool yielded = false;        // the tissue, to the engaged blade
    bool pressed_again = false;  // the engage button, since the last frame
    bool told = false;           // the sink knows of a force or of tissue
    core::Vec3 acting;           // N
    core::Vec3 turning;          // N m
    LocalModel own;              // the simulation's, until it expires
    std::uint64_t loads = 0;     // told to the simulation
    bool loaded = false;         // the last of them was not nothing
  };
  void tell_simulation(Hand& hand, const BladeForce& force, std::int64_t now_ns) noexcept;
  BladeForce feel(std::uint32_t source, Hand& hand, std::int64_t now_ns, std::int64_t late_ns) noexcept;

  const ForceConfig config_;
  const core::CutConfig cut_;
  ForceSink* const sink_;
  ForceSlots* const slots_;
  std::unique_ptr<Tissue> tissue_;
  SimulationLink* link_ = nullptr;
  std::uint64_t revision_ = 0;
  std::uint64_t cut_short_ = 0;
  std::array<std::int64_t, core::kMaxSources> felt_ns_{};
  std::size_t felt_count_ = 0;
  std::array<std::unique_ptr<Hand>, core::kMaxSources> hands_;
};

}  // namespace incise::haptics
