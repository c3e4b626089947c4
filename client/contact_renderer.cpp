#include "client/contact_renderer.hpp"

#include <algorithm>
#include <cmath>
#include <sstream>
#include <stdexcept>

namespace incise::client {
namespace {

using protocol::Vec3;

constexpr double kSmoothing_s = 0.005;    // of the velocity
constexpr double kLongestStep_s = 0.005;  // after a pause of the caller a force grows as in this time at most
constexpr std::int64_t kLongest_ns = 1'000'000'000;  // a plane is valid at most so long, whatever it says
constexpr double kFarthest_m = 1e4;

Vec3 add(const Vec3& a, const Vec3& b, double s = 1) {
  return {a.x + s * b.x, a.y + s * b.y, a.z + s * b.z};
}
Vec3 scale(double s, const Vec3& a) {
  return {s * a.x, s * a.y, s * a.z};
}
double dot(const Vec3& a, const Vec3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
double length(const Vec3& a) {
  return std::sqrt(dot(a, a));
}
bool finite(const Vec3& a) {
  return std::isfinite(a.x) && std::isfinite(a.y) && std::isfinite(a.z);
}
// From a to b, by so much at most.
Vec3 toward(const Vec3& a, const Vec3& b, double most) {
  const Vec3 change = add(b, a, -1);
  const double size = length(change);
  return size > most ? add(a, change, most / size) : b;
}

Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
// The rotation from a to b as its axis times its angle, by the shorter way.
Vec3 turn(const protocol::Quat& a, const protocol::Quat& b) {
  const double w = b.w * a.w + b.x * a.x + b.y * a.y + b.z * a.z;
  const Vec3 va{a.x, a.y, a.z}, vb{b.x, b.y, b.z};
  const Vec3 v = add(add(scale(a.w, vb), va, -b.w), cross(vb, va), -1);
  const double sine = length(v);
  return sine > 0 ? scale((w < 0 ? -2 : 2) * std::atan2(sine, std::abs(w)) / sine, v) : Vec3{};
}

// A place as the server accepts it (PoseReport.not_finite), and about a rotation.
bool is_place(const Vec3& a) {
  return finite(a) && length(a) <= kFarthest_m;
}
bool unit(const protocol::Quat& q) {
  const double squared = q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z;
  return squared > 0.25 && squared < 4;
}
bool amount(double x) {
  return std::isfinite(x) && x >= 0;
}
bool sound(const protocol::LocalContact& c) {
  return finite(c.arm.value_or(Vec3{})) && finite(c.point) && finite(c.normal) && length(c.normal) > 0.5 &&
         length(c.normal) < 2 && amount(c.stiffness_n_per_m) && amount(c.damping_n_s_per_m) &&
         amount(c.cutting_resistance_n) && amount(c.friction_n_s_per_m) && c.valid_for_ns > 0;
}

// What a ramp leaves of the slew limit, N/s.
double slew_beside_ramp(const ContactLimits& l) {
  return l.slew_n_s - (l.ramp_s > 0 ? l.most_n / l.ramp_s : 0);
}

void require(bool condition, const char* name, double found, const char* accepted) {
  if (condition) return;
  std::ostringstream text;
  text << "ContactLimits: " << name << " is " << found << "; accepted are " << accepted;
  throw std::invalid_argument(text.str());
}

}  // namespace

ContactRenderer::ContactRenderer(const ContactLimits& limits) : limits_(limits) {
  const char* const amounts = "finite numbers from 0";
  require(amount(limits.most_n), "most_n", limits.most_n, amounts);
  require(amount(limits.ramp_s), "ramp_s", limits.ramp_s, amounts);
  require(amount(limits.stiffest_n_m), "stiffest_n_m", limits.stiffest_n_m, amounts);
  require(amount(limits.most_torque_n_m), "most_torque_n_m", limits.most_torque_n_m, amounts);
  require(std::isfinite(limits.slew_n_s) && slew_beside_ramp(limits) > 0, "slew_n_s", limits.slew_n_s,
          "finite numbers above most_n / ramp_s");
}

void ContactRenderer::take(const protocol::Force& force, std::int64_t now_ns) {
  const std::scoped_lock lock(mutex_);
  ++newest_.number;
  newest_.until_ns = now_ns;
  newest_.over = true;
  if (!force.contact || !sound(*force.contact)) return;
  newest_.contact = *force.contact;
  protocol::LocalContact& c = newest_.contact;
  c.normal = scale(1 / length(c.normal), c.normal);
  c.stiffness_n_per_m = std::min(c.stiffness_n_per_m, limits_.stiffest_n_m);
  newest_.over = false;
  newest_.until_ns = now_ns + std::min(c.valid_for_ns, kLongest_ns);
}

Wrench ContactRenderer::wrench(const Vec3& tool, const protocol::Quat& orientation, std::int64_t now_ns) {
  if (unit(orientation)) {
    if (orientation_) account_ -= dot(torque_, turn(*orientation_, orientation));
    orientation_ = orientation;
  }
  const double growing = growing_s(now_ns);  // before force() takes the time
  Wrench made{force(tool, now_ns), {}};
  Vec3 wanted = cross(plane_.contact.arm.value_or(Vec3{}), made.force_n);
  if (!finite(wanted)) wanted = {};
  if (const double size = length(wanted); size > limits_.most_torque_n_m)
    wanted = scale(limits_.most_torque_n_m / size, wanted);
  // The force is ramped, so its moment is; an arm that jumps is not.
  const double most =
      limits_.most_n > 0 ? limits_.slew_n_s * limits_.most_torque_n_m / limits_.most_n * growing : 0;
  torque_ = toward(torque_, wanted, most);
  made.torque_n_m = torque_;
  return made;
}

// What a force may grow by at this call, as time. 0 at the first one, and at the first after a silence.
double ContactRenderer::growing_s(std::int64_t now_ns) const {
  const std::int64_t passed_ns = called_ ? std::max<std::int64_t>(0, now_ns - last_ns_) : 0;
  return passed_ns > kSilence_ns ? 0 : std::min(static_cast<double>(passed_ns) * 1e-9, kLongestStep_s);
}

// Nobody knows what the device has done since the last call: it held the force, or its watchdog has let go of it.
void ContactRenderer::begin_again() {
  applied_ = slewed_ = torque_ = velocity_ = {};
  ramp_ = 0;
}

Vec3 ContactRenderer::force(const Vec3& tool, std::int64_t now_ns) {
  {
    const std::scoped_lock lock(mutex_);
    // The same plane keeps the place to which it has given way.
    if (newest_.number != plane_.number) plane_ = newest_;
  }
  const bool usable = is_place(tool);
  const double dt = begun_ ? std::max(0.0, static_cast<double>(now_ns - tool_ns_) * 1e-9) : 0;
  if (dt > 0 && usable) {
    const Vec3 step = add(tool, last_tool_, -1);
    account_ += kLeak_w * dt - dot(applied_, step);
    velocity_ = add(velocity_, add(scale(1 / dt, step), velocity_, -1), dt / (kSmoothing_s + dt));
  }
  const double growing = growing_s(now_ns);
  if (called_ && now_ns - last_ns_ > kSilence_ns) begin_again();
  last_ns_ = now_ns;
  called_ = true;
  if (usable) {
    last_tool_ = tool;
    tool_ns_ = now_ns;
    begun_ = true;
  }

  // The plane: a spring that gives way at its resistance, a damper that does not pull, friction.
  protocol::LocalContact& c = plane_.contact;
  const bool valid = usable && now_ns < plane_.until_ns;
  double energy = 0;
  Vec3 elastic, viscous;
  if (valid) {
    double depth = -dot(c.normal, add(tool, c.point, -1));
    if (c.cutting_resistance_n > 0 && c.stiffness_n_per_m * depth > c.cutting_resistance_n) {
      const double holds = c.cutting_resistance_n / c.stiffness_n_per_m;
      c.point = add(c.point, c.normal, holds - depth);
      depth = holds;
    }
    const double away = dot(c.normal, velocity_);
    if (depth > 0) {
      const double spring = c.stiffness_n_per_m * depth;
      energy = 0.5 * spring * depth;
      elastic = scale(spring, c.normal);
      viscous = scale(std::max(-c.damping_n_s_per_m * away, -spring), c.normal);
    }
    if (c.penetrated) {
      viscous = add(viscous, velocity_, -c.friction_n_s_per_m);
    } else if (depth > 0) {
      viscous = add(viscous, add(velocity_, c.normal, -away), -c.friction_n_s_per_m);
    }
  }
  account_ = std::min(account_, energy + kReserve_j);
  const double held = std::max(account_, 0.0);
  Vec3 wanted =
      add(scale(energy > held ? held / energy : 1, elastic), viscous, std::min(1.0, held / kReserve_j));

  // The limits, in the order of the server's: finite, clamp, slew, ramp.
  if (!finite(wanted)) wanted = {};
  if (const double size = length(wanted); size > limits_.most_n)
    wanted = scale(limits_.most_n / size, wanted);
  slewed_ = toward(slewed_, wanted, slew_beside_ramp(limits_) * growing);
  if (valid && (ramp_ > 0 || energy > 0 || c.penetrated))
    ramp_ = limits_.ramp_s > 0 ? std::min(1.0, ramp_ + growing / limits_.ramp_s) : 1;
  applied_ = scale(ramp_, slewed_);
  // A plane expired while it acted: once the force has faded, the next one starts from nothing.
  if (!valid && !plane_.over && length(slewed_) == 0) ramp_ = 0;
  return applied_;
}

}  // namespace incise::client
