#include "server/haptics/force_stage.hpp"

#include <algorithm>

#include "server/core/stroke/jump.hpp"

namespace incise::haptics {
namespace {

// A source that has been silent for this long is skipped until it sends again.
constexpr std::int64_t kAsleep_ns = 1'000'000'000;

}  // namespace

ForceStage::ForceStage(const ForceConfig& config, const core::CutConfig& cut, std::unique_ptr<Tissue> tissue,
                       ForceSink* sink, ForceSlots* slots)
    : config_(config), cut_(cut), sink_(sink), slots_(slots), tissue_(std::move(tissue)) {
  for (auto& hand : hands_) hand = std::make_unique<Hand>(config_.materials, config_);
}

void ForceStage::opened(std::uint32_t source, const core::Blade& blade) noexcept {
  Hand& hand = *hands_[source];
  hand.blade = blade;
  hand.opened = true;
  hand.has_pose = hand.has_felt = hand.pressed_again = hand.yielded = false;
  hand.own = {};
  hand.model.jump();
  const std::uint32_t losses = slots_ ? (*slots_)[source].losses() : 0;
  const std::uint32_t failed_writes = slots_ ? (*slots_)[source].failed_writes() : 0;
  hand.chain.arm(losses, failed_writes);
  hand.torque_chain.arm(losses, failed_writes);
}

void ForceStage::posed(std::uint32_t source, const core::Pose& pose, std::int64_t arrival_ns,
                       bool jumped) noexcept {
  Hand& hand = *hands_[source];
  const bool same = hand.has_pose && pose.position == hand.pose.position &&
                    pose.orientation == hand.pose.orientation && pose.buttons == hand.pose.buttons;
  if (!same) hand.moved_ns = arrival_ns;
  hand.pressed_again =
      hand.pressed_again || (hand.has_pose && !cut_.engages(hand.pose.buttons) && cut_.engages(pose.buttons));
  // The rule for strokes, applied to blades that do not cut, too.
  hand.jumped = hand.jumped || jumped || (hand.has_pose && is_jump(cut_, hand.blade, hand.pose, pose));
  hand.pose = pose;
  hand.arrival_ns = arrival_ns;
  hand.has_pose = true;
}

void ForceStage::cut(const core::TetMesh& mesh, const core::Delta& delta) noexcept {
  tissue_->note_cuts(mesh, delta.boundary_upserted);
  revision_ = delta.revision;
}

void ForceStage::note_cuts(const core::TetMesh& mesh, std::span<const core::HalfFace> faces) noexcept {
  tissue_->note_cuts(mesh, faces);
}

void ForceStage::restart() noexcept {
  tissue_->heal();
  for (auto& hand : hands_) {
    hand->model.jump();
    hand->own = {};
    hand->yielded = false;
  }
}

void ForceStage::frame(std::int64_t now_ns, std::int64_t late_ns) noexcept {
  felt_count_ = 0;
  for (std::uint32_t source = 0; source < hands_.size(); ++source) {
    Hand& hand = *hands_[source];
    if (!hand.opened || !hand.has_pose) continue;
    const bool quiet = squared_length(hand.acting) == 0;
    if (quiet && now_ns - hand.arrival_ns > kAsleep_ns) {
      hand.has_felt = false;
      hand.model.jump();
      continue;
    }
    const bool fresh = !hand.has_felt || hand.pose.t_ns != hand.felt.t_ns;
    const BladeForce force = feel(source, hand, now_ns, late_ns);
    if (fresh) felt_ns_[felt_count_++] = hand.arrival_ns;
    hand.felt = hand.pose;
    hand.has_felt = true;
    hand.acting = force.newtons;
    hand.turning = force.newton_metres;
    if (slots_) {
      (*slots_)[source].write({{force.newtons.x, force.newtons.y, force.newtons.z},
                               now_ns,
                               force.flags,
                               hand.arrival_ns,
                               {force.newton_metres.x, force.newton_metres.y, force.newton_metres.z}});
    }
    if (link_) tell_simulation(hand, force, now_ns);
    const bool worth = force.feel.contact || squared_length(force.newtons) > 0;
    const bool changed = fresh || hand.chain.faults() != 0;
    if (sink_ && ((worth && changed) || (hand.told && !worth))) sink_->feel(force);
    hand.told = worth;
  }
}

// What the hand gets, the body gets with the other sign. Once more, with nothing, when that ends.
void ForceStage::tell_simulation(Hand& hand, const BladeForce& force, std::int64_t now_ns) noexcept {
  const bool acts = force.feel.contact || squared_length(force.newtons) > 0;
  const bool due = acts || hand.loaded;
  hand.loaded = acts;
  if (!due || now_ns >= link_->wanted_until_ns.load(std::memory_order_relaxed)) return;
  BladeLoad load;
  load.number = ++hand.loads;
  load.revision = revision_;
  load.pose_t_ns = force.pose_t_ns;
  load.now_ns = now_ns;
  if (force.feel.engagement.length_m > 0)
    load.contact = force.feel.contact && !force.feel.contact->penetrated ? ContactState::kPresses
                                                                         : ContactState::kInside;
  load.engaged = cut_.engages(hand.pose.buttons);
  load.line = core::blade_line(hand.blade, hand.pose);
  load.tool = hand.pose.position;
  load.force = force.newtons;
  load.engaged_m = force.feel.engagement.length_m;
  ProbeWork work;
  load.loads = spread(*tissue_, hand.model.line(), load.line, force.feel.engagement, force.newtons, work);
  cut_short_ += work.cut_short;
  load.torque = cross(load.loads.center - load.tool, load.force);
  link_->loads[force.source].write(load);
}

BladeForce ForceStage::feel(std::uint32_t source, Hand& hand, std::int64_t now_ns,
                            std::int64_t late_ns) noexcept {
  BladeForce force;
  force.jumped = hand.jumped;
  if (hand.jumped) hand.model.jump();
  hand.jumped = false;
  BladeMotion motion;
  motion.line = core::blade_line(hand.blade, hand.pose);
  motion.tool = hand.pose.position;
  motion.engaged = cut_.engages(hand.pose.buttons);
  motion.orientation = hand.pose.orientation;
  motion.ramping = hand.chain.ramping() && !hand.chain.latched();
  // Work is done only by what a device makes.
  const double device_torque = slots_ ? (*slots_)[source].torque_limit() : 0;
  if (device_torque > 0) motion.torque = hand.turning;
  if (hand.has_felt) {
    motion.dt_s = static_cast<double>(hand.pose.t_ns - hand.felt.t_ns) * 1e-9;
    motion.elapsed_s = static_cast<double>(now_ns - hand.last_frame_ns) * 1e-9;
  }
  hand.last_frame_ns = now_ns;

  force.source = source;
  force.pose_t_ns = hand.pose.t_ns;
  force.pose_arrival_ns = hand.arrival_ns;
  if (link_) link_->models[source].read(hand.own);
  const bool own = now_ns < hand.own.expires_ns;
  force.feel = hand.model.update(*tissue_, motion, hand.acting, own ? &hand.own : nullptr);
  cut_short_ += force.feel.work.cut_short;
  hand.yielded = motion.engaged && hand.model.inside();

  if (hand.pressed_again && !force.feel.contact) {
    hand.chain.rearm_after_faults();
    hand.torque_chain.rearm_after_faults();
  }
  hand.pressed_again = false;
  SafetyInput in;
  in.now_ns = now_ns;
  in.wanted = force.feel.force;
  in.contact = force.feel.contact.has_value();
  in.pose_ns = hand.arrival_ns;
  in.moved_ns = hand.moved_ns;
  in.late_ns = late_ns;
  if (slots_) {
    const ForceSlot& slot = (*slots_)[source];
    in.device_most_n = slot.limit();
    in.losses = slot.losses();
    in.failed_writes = slot.failed_writes();
  }
  force.newtons = hand.chain.update(in);
  if (config_.most_torque_n_m > 0) {
    // By the same frames and faults; whatever ends the force ends the torque.
    SafetyInput turn = in;
    turn.wanted = cross(force.feel.arm, force.feel.force);
    turn.device_most_n = device_torque;
    force.newton_metres = hand.torque_chain.update(turn);
    if (squared_length(force.newtons) == 0) force.newton_metres = {};
  }
  force.faults = hand.chain.faults();
  const auto flag = [&](bool set, ForceFlag bit) { force.flags |= set ? std::uint32_t{bit} : 0u; };
  flag(in.contact, kForceContact);
  flag(hand.chain.limited(), kForceLimited);
  flag(hand.chain.ramping(), kForceRamping);
  flag(hand.chain.latched(), kForceLatchedOff);
  return force;
}

}  // namespace incise::haptics
