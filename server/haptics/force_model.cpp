#include "server/haptics/force_model.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

namespace incise::haptics {
namespace {

using core::Vec3;

constexpr double kSmoothing_s = 0.005;  // of the velocity: one pose's noise must not be felt
constexpr double kFaceSlack_h = 0.05;   // what the surface may have moved between two frames
constexpr double kDeepest_h = 6;        // the surface is not looked for farther off
// Tissue yields when the hand has got this part of what it holds, or would have got it for so long; where the account does not cover that, when
// the spring would make so many times as much.
constexpr double kGot = 0.98, kYields_s = 0.01, kUncovered = 2;
// A blade that presses no faster than this waits on the surface until the ramp of a first contact is over, m/s. A stroke does not: nobody
// wants it to begin two seconds late.
constexpr double kPatient_m_s = 0.03;
// A surface's turn is taken from places so far around, in mean edges: beyond the dent that the blade itself makes.
constexpr double kAround_h = 2;
// The front is forgotten when the blade is this far behind it or beside it: there the map of cuts is up to date,
// since faces open at most two elements behind the blade.
constexpr double kForget_h = 2, kAside_h = 0.5;

Vec3 across(const Vec3& v, const Vec3& unit) {
  return v - dot(v, unit) * unit;
}

// The rotation from a to b as a vector: its axis times its angle, world frame.
Vec3 turn(const core::Quat& a, const core::Quat& b) {
  // b a*, by the shorter way.
  const double w = b.w * a.w + b.x * a.x + b.y * a.y + b.z * a.z;
  const Vec3 va{a.x, a.y, a.z}, vb{b.x, b.y, b.z};
  const Vec3 v = a.w * vb - b.w * va - cross(vb, va);
  const double sine = length(v);
  if (!(sine > 0)) return {};
  return ((w < 0 ? -2 : 2) * std::atan2(sine, std::abs(w)) / sine) * v;
}

// Two directions as an orthonormal frame; nothing if they are nearly one.
std::optional<Mat3> frame(const Vec3& a, const Vec3& b, double least) {
  const Vec3 normal = cross(a, b);
  if (!(length(a) > least) || !(length(b) > least) || !(length(normal) > least * least)) return std::nullopt;
  const Vec3 x = normalized(a), z = normalized(normal);
  return Mat3{x, cross(z, x), z};
}

// The direction `out` at a place of the surface at rest, as the surface there has turned: by the tissue around, since the one
// element under a tip is bent by the tip itself. Its normal would tilt, push the tip aside, tilt farther, and flip at the next element.
Vec3 turned(const Tissue& tissue, const SurfacePoint& place, const Vec3& out, ProbeWork& work) noexcept {
  const double r = kAround_h * tissue.h();
  const Vec3 least_along = std::abs(out.x) < 0.6 ? Vec3{1, 0, 0} : Vec3{0, 1, 0};
  const Vec3 u = normalized(cross(out, least_along)), v = cross(out, u);
  std::array<Vec3, 4> rest, now;
  const std::array<Vec3, 4> ways{u, -u, v, -v};
  for (std::size_t i = 0; i < ways.size(); ++i) {
    const auto found = tissue.surface().nearest(place.point + r * ways[i], r, work);
    if (!found) return tissue.rest().map(core::tet_of(place.face)).normal_now(out);
    rest[i] = found->point;
    now[i] = tissue.rest().map(core::tet_of(found->face)).now(found->point);
  }
  const auto before = frame(rest[0] - rest[1], rest[2] - rest[3], 0.2 * r);
  const auto after = frame(now[0] - now[1], now[2] - now[3], 0.2 * r);
  if (!before || !after) return tissue.rest().map(core::tet_of(place.face)).normal_now(out);
  return *after * before->transposed(out);
}

}  // namespace

ForceModel::ForceModel(const Materials& materials, double stiffest_n_m, double damping_n_s_m, bool resists)
    : materials_(materials), stiffest_(stiffest_n_m), damping_(damping_n_s_m), resists_(resists) {}

void ForceModel::jump() noexcept {
  phase_ = Phase::kFree;
  has_last_ = false;
  velocity_ = tool_velocity_ = last_elastic_ = {};
  depth_ = depth_at_rest_ = yields_s_ = 0;
  yields_at_n_ = INFINITY;
}

Feel ForceModel::update(const Tissue& tissue, const BladeMotion& motion, const Vec3& applied,
                        const LocalModel* own) noexcept {
  Feel feel;
  line_ = tissue.rest().line(motion.line, feel.work);
  feel.engagement = probe(tissue, materials_, line_, feel.work);
  feel.engagement.stiffness_n_m = std::min(feel.engagement.stiffness_n_m, stiffest_);
  const Engagement& engagement = feel.engagement;
  const double at = engagement.length_m > 0 ? engagement.middle : 0.5;
  map_ = line_.deformed ? tissue.rest().map(line_.tet(at)) : LocalMap{};
  if (has_last_) book(motion, applied);
  account_ += kLeak_w * motion.elapsed_s;
  if (has_last_) find_velocity(motion, at);
  Elastic elastic;
  const bool shared = has_last_ && line_.deformed && !own_acts_;
  if (engagement.length_m == 0) {
    phase_ = Phase::kFree;
    depth_ = depth_at_rest_ = 0;
    yields_at_n_ = INFINITY;
  } else {
    if (resists_ && phase_ == Phase::kInside && withdrawn(tissue, engagement, feel.work)) {
      phase_ = Phase::kContact;
      depth_ = depth_at_rest_ = 0.5 * yielded_at_;
    }
    if (phase_ != Phase::kInside) find_depth(tissue, motion, has_last_ ? moved_at_rest() : 0, feel);
    if (shared && phase_ == Phase::kInside) book_tissue(motion, at, applied);
    if (phase_ == Phase::kContact) {
      find_hold(motion, engagement);
      elastic = spring(engagement);
      if (shared) book_tissue(motion, elastic);
      elastic = press(motion, engagement, elastic, applied, feel);
    }
    if (phase_ == Phase::kInside) elastic = cut(motion, engagement, tissue.h(), feel);
  }
  if (own) elastic = render(*own, motion, feel);
  own_acts_ = own != nullptr;
  has_last_ = true;
  last_line_ = motion.line;
  last_tool_ = motion.tool;
  last_orientation_ = motion.orientation;
  before_ = line_;

  account_ = std::min(account_, elastic.energy + kReserve_j);
  const double friction_share = std::min(1.0, std::max(account_, 0.0) / kReserve_j);
  last_elastic_ = covered(elastic.energy) * elastic.force;
  feel.force = last_elastic_ + friction_share * feel.force;
  const double middle = engagement.length_m > 0 ? 0.5 * (engagement.from + engagement.to) : 0.5;
  feel.arm = lerp(motion.line.heel, motion.line.tip, middle) - motion.tool;
  return feel;
}

// How much of a spring's force the account covers.
double ForceModel::covered(double energy) const noexcept {
  const double held = std::max(account_, 0.0);
  return energy > held ? held / energy : 1;
}

Vec3 ForceModel::step(const BladeMotion& motion, double at) const noexcept {
  return lerp(motion.line.heel, motion.line.tip, at) - lerp(last_line_.heel, last_line_.tip, at);
}

Vec3 ForceModel::relative_step(double at) const noexcept {
  return map_.now_from_rest * (line_.rest(at) - before_.rest(at));
}

// The farthest that a point of the edge has come in the body at rest, m.
double ForceModel::moved_at_rest() const noexcept {
  double moved = 0;
  for (const double at : {0.0, 0.5, 1.0}) moved = std::max(moved, distance(line_.rest(at), before_.rest(at)));
  return moved;
}

// What acted on the hand since the last call did work there.
void ForceModel::book(const BladeMotion& motion, const Vec3& applied) noexcept {
  account_ -= dot(applied, motion.tool - last_tool_) +
              dot(motion.torque, turn(last_orientation_, motion.orientation));
  if (tissue_account_ < kTissueReserve_j)
    tissue_account_ = std::min(kTissueReserve_j, tissue_account_ + kTissueLeak_w * motion.elapsed_s);
}

// Inside, where the tissue moved, a part of that was the tissue's.
void ForceModel::book_tissue(const BladeMotion& motion, double at, const Vec3& applied) noexcept {
  const double given = dot(applied, step(motion, at) - relative_step(at));
  take_from_tissue(std::min(given, tissue_account_));
}

// Pressed, what the hand has put in and the spring has not is the tissue's, and what the spring has beyond that was. (Tissue at the edge and
// at the surface do not move alike, and a simulation moves both in long steps: how far they went does not tell.)
void ForceModel::book_tissue(const BladeMotion& motion, const Elastic& spring) noexcept {
  const double lacks = spring.energy - account_;
  const double put_in = std::max(0.0, -dot(last_elastic_, motion.tool - last_tool_));
  take_from_tissue(lacks > 0 ? std::min(lacks, tissue_account_) : std::max(lacks, -put_in));
}

void ForceModel::take_from_tissue(double energy) noexcept {
  account_ += energy;
  tissue_account_ -= energy;
}

// The velocity of the edge's parameter `at`, relative to the tissue.
void ForceModel::find_velocity(const BladeMotion& motion, double at) noexcept {
  const Vec3 way = relative_step(at);
  if (motion.dt_s > 0) {
    tool_velocity_ += motion.dt_s / (kSmoothing_s + motion.dt_s) *
                      ((1 / motion.dt_s) * (motion.tool - last_tool_) - tool_velocity_);
  } else {
    tool_velocity_ = kSmoothing_s / (kSmoothing_s + motion.elapsed_s) * tool_velocity_;
  }
  // Between two poses the tissue may move, too.
  const double dt = motion.dt_s > 0 ? motion.dt_s : squared_length(way) > 0 ? motion.elapsed_s : 0;
  if (!(dt > 0)) {
    velocity_ = kSmoothing_s / (kSmoothing_s + motion.elapsed_s) * velocity_;
    return;
  }
  velocity_ += dt / (kSmoothing_s + dt) * ((1 / dt) * way - velocity_);
}

// Free or in contact, with part of the edge inside: finds how deep it is, and which way is out.
void ForceModel::find_depth(const Tissue& tissue, const BladeMotion& motion, double moved,
                            Feel& feel) noexcept {
  const Engagement& engagement = feel.engagement;
  const bool first = phase_ == Phase::kFree;
  const double h = tissue.h();
  if (first && !has_last_) {  // it did not move there: the way out is unknown
    phase_ = Phase::kInside;
    yielded_at_ = 0;
    front_ = line_.rest(engagement.middle);
    front_heading_ = {};
    return;
  }
  // The depth of a point changes by no more than it moves, so the surface is not farther off than this.
  const double radius = std::min(depth_at_rest_ + moved + kFaceSlack_h * h, kDeepest_h * h);
  std::optional<SurfacePoint> deepest;
  Vec3 way, out;  // from the edge to the surface, as it is now; out of the tissue, at rest
  for (const double at : {engagement.from, 0.5 * (engagement.from + engagement.to), engagement.to}) {
    const Vec3 rest = line_.rest(at);
    const auto surface = tissue.surface().nearest(rest, radius, feel.work);
    if (!surface) continue;
    const Vec3 p = lerp(motion.line.heel, motion.line.tip, at);
    const Vec3 here = (line_.deformed ? tissue.rest().map(core::tet_of(surface->face)).now(surface->point)
                                      : surface->point) -
                      p;
    if (deepest && squared_length(here) <= squared_length(way)) continue;
    deepest = surface;
    way = here;
    const Vec3 nearest = normalized(surface->point - rest);
    const bool under = surface->distance_m > 1e-3 * h && dot(nearest, surface->normal) > 0;
    out = under ? nearest : surface->normal;
  }
  phase_ = Phase::kContact;
  if (deepest) {
    normal_ = line_.deformed ? turned(tissue, *deepest, out, feel.work) : out;
    depth_ = line_.deformed ? std::max(0.0, dot(way, normal_)) : deepest->distance_m;
    depth_at_rest_ = deepest->distance_m;
  } else if (!first) {
    // Deeper than the search reaches: follow its motion.
    const double deeper = -dot(relative_step(engagement.middle), normal_);
    depth_ = std::max(depth_ + deeper, 0.0);
    depth_at_rest_ = std::max(depth_at_rest_ + deeper, 0.0);
  } else {
    get_in({}, engagement);
  }
}

// Whether the edge is less than half as deep as when the surface gave way.
bool ForceModel::withdrawn(const Tissue& tissue, const Engagement& engagement,
                           ProbeWork& work) const noexcept {
  if (yielded_at_ == 0) return false;
  for (const double at : {engagement.from, 0.5 * (engagement.from + engagement.to), engagement.to}) {
    if (!tissue.surface().nearest(line_.rest(at), 0.5 * yielded_at_, work)) return false;
  }
  return true;
}

// The blade enters, from the surface or without a contact before: the front starts where the spring just holds. `along`: unit.
void ForceModel::get_in(const Vec3& along, const Engagement& engagement) noexcept {
  const double hold = engagement.fracture_n / engagement.stiffness_n_m;
  phase_ = Phase::kInside;
  yields_s_ = 0;
  yields_at_n_ = INFINITY;
  yielded_at_ = depth_at_rest_;
  front_heading_ = map_.rest_from_now * along;
  front_ = line_.rest(engagement.middle) - std::min(depth_, hold) * front_heading_;
}

// What the surface holds, N; for a blade that does not cut, anything. More edge that comes in while the hand gets what it held when the spring
// first pulled as hard changes nothing: in truth the tissue would have given way there.
void ForceModel::find_hold(const BladeMotion& motion, const Engagement& engagement) noexcept {
  const double most = motion.engaged
                          ? std::min(yields_at_n_, std::max(engagement.puncture_n, engagement.fracture_n))
                          : INFINITY;
  holds_n_ = most;
  yields_at_n_ = engagement.stiffness_n_m * depth_ >= most ? most : INFINITY;
}

// The spring to the surface, which pulls no harder than that holds.
ForceModel::Elastic ForceModel::spring(const Engagement& engagement) const noexcept {
  const double k = engagement.stiffness_n_m, force = std::min(k * depth_, holds_n_);
  return {force * normal_, force * (depth_ - 0.5 * force / k)};
}

ForceModel::Elastic ForceModel::press(const BladeMotion& motion, const Engagement& engagement,
                                      const Elastic& spring, const Vec3& applied, Feel& feel) noexcept {
  const double stiffness = engagement.stiffness_n_m, most = holds_n_;
  const double force = length(spring.force), share = covered(spring.energy);
  // It gives way when the hand has got what it holds: a simulation that moves the tissue in steps must not tear it before. A device that makes
  // less, or a tool that only turns (its account covers little), must get in as well.
  const bool yields = stiffness * depth_ >= most && (share == 1 || stiffness * depth_ >= kUncovered * most);
  const double into = dot(velocity_, normal_);
  const bool waits = resists_ && motion.ramping && -into < kPatient_m_s;
  yields_s_ = !yields ? 0 : waits ? yields_s_ : yields_s_ + motion.elapsed_s;
  const bool got = yields && dot(applied, normal_) > kGot * most;
  // A blade that enters an existing slit punctures nothing.
  const bool open = engagement.uncut_m < 0.5 * engagement.length_m;
  if (open || got || yields_s_ > kYields_s || most == 0) {
    const Vec3 edge = normalized(motion.line.tip - motion.line.heel);
    get_in(-normalized(across(normal_, edge)), engagement);
    return {};
  }
  // The damper can only reduce the force of a spring that relaxes: the surface does not pull.
  const double damper = std::max(-damping_ * into, -force);
  feel.force = damper * normal_ - engagement.friction_n_s_m * across(velocity_, normal_);
  feel.contact =
      ContactPlane{motion.tool + depth_ * normal_, normal_, stiffness, damping_, motion.engaged ? most : 0,
                   engagement.friction_n_s_m,      false};
  return spring;
}

// A spring in all directions that gives way at its resistance, and a damper that does not pull.
ForceModel::Elastic ForceModel::render(const LocalModel& own, const BladeMotion& motion,
                                       Feel& feel) noexcept {
  feel.force = {};
  feel.contact.reset();
  if (own.number != own_number_) own_point_ = own.point;
  own_number_ = own.number;
  Vec3 stretch = own_point_ - motion.tool;
  if (dot(own.normal, stretch) <= 0) return {};
  // Not stiffer than a device can render: the trace is no smaller than the largest eigenvalue.
  const Mat3& k = own.stiffness;
  const double trace = k.x.x + k.y.y + k.z.z;
  const double softer = trace > stiffest_ ? stiffest_ / trace : 1;
  Vec3 spring = softer * (k * stretch);
  if (const double size = length(spring); own.resistance_n > 0 && size > own.resistance_n) {
    const double share = own.resistance_n / size;
    own_point_ = motion.tool + share * stretch;
    stretch = share * stretch;
    spring = share * spring;
  }
  const double damping = std::min(own.damping_n_s_m, damping_);
  feel.force = std::max(-damping * dot(own.normal, tool_velocity_), -std::max(0.0, dot(spring, own.normal))) *
               own.normal;
  feel.contact = ContactPlane{own_point_,
                              own.normal,
                              softer * dot(own.normal, k * own.normal),
                              damping,
                              own.resistance_n,
                              0,
                              feel.engagement.length_m > 0 && phase_ == Phase::kInside};
  return {spring, 0.5 * dot(stretch, spring)};
}

ForceModel::Elastic ForceModel::cut(const BladeMotion& motion, const Engagement& engagement, double h,
                                    Feel& feel) noexcept {
  // Steps from the front as they are now.
  const Vec3 middle = line_.rest(engagement.middle);
  const Vec3 edge = normalized(motion.line.tip - motion.line.heel);
  const Vec3 heading = normalized(map_.now_from_rest * front_heading_);
  const double stiffness = engagement.stiffness_n_m;
  Vec3 ahead = across(map_.now_from_rest * (middle - front_), edge);
  double behind = 0;  // how far the blade is behind the front, m
  if (!motion.engaged) {
    front_ = middle;
    front_heading_ = ahead = {};
  } else if (const double along = dot(ahead, heading); along < 0) {
    if (-along > kForget_h * h || length(ahead - along * heading) > kAside_h * h) {
      front_ = middle;
      front_heading_ = {};
    } else {
      behind = -along;
    }
    ahead = {};
  }
  const double holds = engagement.fracture_n / stiffness;
  if (const double stretch = length(ahead); stretch > holds) {
    front_ += map_.rest_from_now * ((1 - holds / stretch) * ahead);
    if (engagement.fracture_n > 0) front_heading_ = map_.rest_from_now * ((1 / stretch) * ahead);
    ahead = (holds / stretch) * ahead;
  }
  feel.force = -engagement.friction_n_s_m * velocity_;
  // The contact plane: square to the stretch of the spring, or to the last motion of the front.
  const double stretch = length(ahead);
  const Vec3 way = stretch > 0 ? (1 / stretch) * ahead : normalized(map_.now_from_rest * front_heading_);
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
