#include "server/haptics/force_model.hpp"

#include <algorithm>
#include <cmath>

namespace incise::haptics {
namespace {

using core::Vec3;

constexpr double kSmoothing_s = 0.005;  // of the velocity: one pose's noise must not be felt
constexpr double kFaceSlack_h = 0.05;   // what the surface may have moved between two frames
constexpr double kDeepest_h = 6;        // the surface is not looked for farther off
// The front is forgotten when the blade is this far behind it or beside it: there the map of cuts is up to date,
// since faces open at most two elements behind the blade.
constexpr double kForget_h = 2, kAside_h = 0.5;

Vec3 across(const Vec3& v, const Vec3& unit) {
  return v - dot(v, unit) * unit;
}

}  // namespace

ForceModel::ForceModel(const Materials& materials, double stiffest_n_m, double damping_n_s_m)
    : materials_(materials), stiffest_(stiffest_n_m), damping_(damping_n_s_m) {}

void ForceModel::jump() noexcept {
  phase_ = Phase::kFree;
  has_last_ = false;
  velocity_ = {};
  depth_ = 0;
}

Feel ForceModel::update(const Tissue& tissue, const BladeMotion& motion, const Vec3& applied) noexcept {
  if (has_last_) account_ -= dot(applied, motion.tool - last_tool_);
  account_ += kLeak_w * motion.elapsed_s;

  Feel feel;
  feel.engagement = probe(tissue, materials_, motion.line, feel.work);
  feel.engagement.stiffness_n_m = std::min(feel.engagement.stiffness_n_m, stiffest_);
  const Engagement& engagement = feel.engagement;
  const double moved = has_last_ ? travel(motion.line, last_line_) : 0;
  find_velocity(motion, engagement);
  Elastic elastic;
  if (engagement.length_m == 0) {
    phase_ = Phase::kFree;
    depth_ = 0;
  } else {
    if (phase_ != Phase::kInside) find_depth(tissue, motion, moved, feel);
    if (phase_ == Phase::kContact) elastic = press(motion, engagement, feel);
    if (phase_ == Phase::kInside) elastic = cut(motion, engagement, tissue.h(), feel);
  }
  has_last_ = true;
  last_line_ = motion.line;
  last_tool_ = motion.tool;

  account_ = std::min(account_, elastic.energy + kReserve_j);
  const double held = std::max(account_, 0.0);
  const double elastic_share = elastic.energy > held ? held / elastic.energy : 1;
  const double friction_share = std::min(1.0, held / kReserve_j);
  feel.force = elastic_share * elastic.force + friction_share * feel.force;
  return feel;
}

// The velocity of the tool at the middle of the edge inside.
void ForceModel::find_velocity(const BladeMotion& motion, const Engagement& engagement) noexcept {
  if (!has_last_) return;
  if (!(motion.dt_s > 0)) {
    velocity_ = kSmoothing_s / (kSmoothing_s + motion.elapsed_s) * velocity_;
    return;
  }
  const double at = engagement.length_m > 0 ? engagement.middle : 0.5;
  const Vec3 step = lerp(motion.line.heel, motion.line.tip, at) - lerp(last_line_.heel, last_line_.tip, at);
  velocity_ += motion.dt_s / (kSmoothing_s + motion.dt_s) * ((1 / motion.dt_s) * step - velocity_);
}

// Free or in contact, with part of the edge inside: finds how deep it is, and which way is out.
void ForceModel::find_depth(const Tissue& tissue, const BladeMotion& motion, double moved,
                            Feel& feel) noexcept {
  const Engagement& engagement = feel.engagement;
  const bool first = phase_ == Phase::kFree;
  const double h = tissue.h();
  if (first && !has_last_) {  // it did not move there: the way out is unknown
    phase_ = Phase::kInside;
    front_ = lerp(motion.line.heel, motion.line.tip, engagement.middle);
    front_heading_ = {};
    return;
  }
  // The depth of a point changes by no more than it moves, so the surface is not farther off than this.
  const double radius = std::min(depth_ + moved + kFaceSlack_h * h, kDeepest_h * h);
  std::optional<SurfacePoint> deepest;
  Vec3 deepest_point;
  for (const double at : {engagement.from, 0.5 * (engagement.from + engagement.to), engagement.to}) {
    const Vec3 p = lerp(motion.line.heel, motion.line.tip, at);
    const auto surface = tissue.surface().nearest(p, radius, feel.work);
    if (!surface || (deepest && surface->distance_m <= deepest->distance_m)) continue;
    deepest = surface;
    deepest_point = p;
  }
  phase_ = Phase::kContact;
  if (deepest) {
    depth_ = deepest->distance_m;
    const Vec3 out = normalized(deepest->point - deepest_point);
    normal_ = depth_ > 1e-3 * h && dot(out, deepest->normal) > 0 ? out : deepest->normal;
  } else if (!first) {
    // Deeper than the search reaches: follow its motion.
    const double at = engagement.middle;
    depth_ -=
        dot(lerp(motion.line.heel, motion.line.tip, at) - lerp(last_line_.heel, last_line_.tip, at), normal_);
    depth_ = std::max(depth_, 0.0);
  } else {
    get_in(lerp(motion.line.heel, motion.line.tip, engagement.middle), {}, engagement);
  }
}

// The blade enters, from the surface or without a contact before: the front starts where the spring just holds.
void ForceModel::get_in(const Vec3& middle, const Vec3& along, const Engagement& engagement) noexcept {
  const double hold = engagement.fracture_n / engagement.stiffness_n_m;
  phase_ = Phase::kInside;
  front_ = middle - std::min(depth_, hold) * along;
  front_heading_ = along;
}

ForceModel::Elastic ForceModel::press(const BladeMotion& motion, const Engagement& engagement,
                                      Feel& feel) noexcept {
  const double stiffness = engagement.stiffness_n_m;
  const double holds = std::max(engagement.puncture_n, engagement.fracture_n);
  // A blade that enters an existing slit punctures nothing.
  const bool open = engagement.uncut_m < 0.5 * engagement.length_m;
  if (open || (motion.engaged && stiffness * depth_ > holds)) {
    const Vec3 edge = normalized(motion.line.tip - motion.line.heel);
    get_in(lerp(motion.line.heel, motion.line.tip, engagement.middle), -normalized(across(normal_, edge)),
           engagement);
    return {};
  }
  const double into = dot(velocity_, normal_);
  const double spring = stiffness * depth_;
  // The damper can only reduce the force of a spring that relaxes: the surface does not pull.
  const double damper = std::max(-damping_ * into, -spring);
  feel.force = damper * normal_ - engagement.friction_n_s_m * across(velocity_, normal_);
  feel.contact =
      ContactPlane{motion.tool + depth_ * normal_, normal_, stiffness, damping_, motion.engaged ? holds : 0,
                   engagement.friction_n_s_m,      false};
  return {spring * normal_, 0.5 * stiffness * depth_ * depth_};
}

ForceModel::Elastic ForceModel::cut(const BladeMotion& motion, const Engagement& engagement, double h,
                                    Feel& feel) noexcept {
  const Vec3 middle = lerp(motion.line.heel, motion.line.tip, engagement.middle);
  const Vec3 edge = normalized(motion.line.tip - motion.line.heel);
  const double stiffness = engagement.stiffness_n_m;
  Vec3 ahead = across(middle - front_, edge);
  double behind = 0;  // how far the blade is behind the front, m
  if (!motion.engaged) {
    front_ = middle;
    front_heading_ = ahead = {};
  } else if (const double along = dot(ahead, front_heading_); along < 0) {
    if (-along > kForget_h * h || length(ahead - along * front_heading_) > kAside_h * h) {
      front_ = middle;
      front_heading_ = {};
    } else {
      behind = -along;
    }
    ahead = {};
  }
  const double holds = engagement.fracture_n / stiffness;
  if (const double stretch = length(ahead); stretch > holds) {
    front_ += (1 - holds / stretch) * ahead;
    if (engagement.fracture_n > 0) front_heading_ = (1 / stretch) * ahead;
    ahead = (holds / stretch) * ahead;
  }
  feel.force = -engagement.friction_n_s_m * velocity_;
  // The contact plane: square to the stretch of the spring, or to the last motion of the front.
  const double stretch = length(ahead);
  const Vec3 way = stretch > 0 ? (1 / stretch) * ahead : front_heading_;
  const bool plane = motion.engaged && engagement.fracture_n > 0 && squared_length(way) > 0;
  feel.contact = ContactPlane{plane ? motion.tool - (stretch - behind) * way : motion.tool,
                              plane ? -way : Vec3{0, 0, 1},
                              plane ? stiffness : 0,
                              0,
                              plane ? engagement.fracture_n : 0,
                              engagement.friction_n_s_m,
                              true};
  return {-stiffness * ahead, 0.5 * stiffness * stretch * stretch};
}

}  // namespace incise::haptics
