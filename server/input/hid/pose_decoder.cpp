#include "server/input/hid/pose_decoder.hpp"

#include <algorithm>
#include <cmath>

namespace incise::input {
namespace {

using core::product;
using core::Quat;
using core::Vec3;

constexpr double kFarthest = 1e6;  // metres, radians or deflections: a larger number is not part of a pose

// The rotation by a rotation vector: its direction is the axis, its length the angle.
Quat turn_by(const Vec3& v) {
  const double angle = core::length(v);
  if (angle < 1e-12) return {};
  const double s = std::sin(angle / 2) / angle;
  return {std::cos(angle / 2), s * v.x, s * v.y, s * v.z};
}

double component(const Vec3& v, std::size_t i) {
  return i == 0 ? v.x : i == 1 ? v.y : v.z;
}

bool near_unit(const std::array<double, 4>& q) {
  const double n2 = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
  return n2 > 0.25 && n2 < 4;
}

// Calls visit(field) for each field of a tool.
template <class Visit>
void each_field(const ToolProfile& tool, Visit&& visit) {
  for (const auto& field : tool.position_fields) {
    if (field) visit(*field);
  }
  for (const auto& field : tool.rotation_fields) {
    if (field) visit(*field);
  }
  for (const auto& button : tool.buttons) visit(button.field);
  if (tool.valid) visit(tool.valid->field);
  if (tool.home) visit(tool.home->field);
}

}  // namespace

PoseDecoder::PoseDecoder(const DeviceProfile& profile, const Placement& placement)
    : profile_(profile),
      placement_(placement),
      numbered_([&] {
        std::uint8_t number = 0;
        for (const ToolProfile& tool : profile.tools) {
          each_field(tool, [&](const ReportField& field) { number = std::max(number, field.report); });
        }
        return number != 0;
      }()),
      tools_(profile.tools.size()) {
  const auto need = [&](const ReportField& field) {
    need_[field.report] = std::max(need_[field.report], field.end());
  };
  for (std::size_t i = 0; i < tools_.size(); ++i) {
    each_field(profile_.tools[i], [&](const ReportField& field) {
      need(field);
      tools_[i].reports[field.report / 64] |= std::uint64_t{1} << field.report % 64;
    });
  }
  if (profile_.counter) need(*profile_.counter);
  if (profile_.clock) {
    need(*profile_.clock);
    clock_.emplace(profile_.clock->scale, profile_.clock->bits);
  }
}

std::span<const PoseDecoder::Sample> PoseDecoder::decode(std::span<const std::uint8_t> report,
                                                         std::int64_t arrival_ns) noexcept {
  ++counts_.reports;
  const std::uint8_t number = numbered_ && !report.empty() ? report[0] : 0;
  const std::uint32_t need = need_of(number);
  if (need == 0) {
    ++counts_.other;
    return {};
  }
  if (report.size() < need) {
    ++counts_.short_ones;
    return {};
  }
  // A bad report must not change clock or counter: everything is read before anything is kept.
  std::array<Axes, kMaxTools> axes;
  for (std::size_t i = 0; i < tools_.size(); ++i) {
    axes[i] = tools_[i].axes;
    if (!read_axes(profile_.tools[i], number, report, axes[i])) {
      ++counts_.bad_values;
      return {};
    }
  }
  if (!follow_counter(number, report)) return {};
  const std::int64_t t_ns = time_of(number, report, arrival_ns);
  if (t_ns == INT64_MIN) return {};

  std::size_t count = 0;
  for (std::size_t i = 0; i < tools_.size(); ++i) {
    const ToolProfile& profile = profile_.tools[i];
    Tool& tool = tools_[i];
    if ((tool.reports[number / 64] >> number % 64 & 1) == 0) continue;
    tool.axes = axes[i];
    const auto on = [&](const std::optional<ToolProfile::Switch>& sw) {
      return sw && sw->field.report == number && sw->field.value(report) >= sw->from;
    };
    if (profile.valid && profile.valid->field.report == number) tool.valid = on(profile.valid);
    // A device at rest may send nothing: not all of the time since was motion.
    const double most_s = 4 / profile_.rate_hz;
    const double dt_s = tool.t_ns == 0 ? 0 : std::min(static_cast<double>(t_ns - tool.t_ns) * 1e-9, most_s);
    tool.t_ns = t_ns;
    integrate(profile, tool, number, dt_s);
    if (on(profile.home)) {
      tool.place = {};
      tool.turn = {};
    }
    Sample& sample = samples_[count++];
    sample.tool = i;
    sample.valid = tool.valid;
    const bool absolute = profile.position == ToolProfile::Position::kAbsolute;
    const auto& p = tool.axes.position;
    sample.pose = to_world(absolute ? Vec3{p[0], p[1], p[2]} : tool.place, rotation_of(profile, tool));
    sample.pose.t_ns = t_ns;
    sample.pose.buttons = tool.axes.buttons;
  }
  return std::span(samples_).first(count);
}

bool PoseDecoder::follow_counter(std::uint8_t number, std::span<const std::uint8_t> report) noexcept {
  if (!profile_.counter || profile_.counter->report != number) return true;
  const std::uint64_t count = profile_.counter->bits_of(report);
  const std::uint64_t mask = (std::uint64_t{1} << profile_.counter->bits) - 1;
  const auto last = last_count_;
  last_count_ = count;
  if (!last) return true;
  const std::uint64_t ahead = (count - *last) & mask;
  if (ahead == 0) {
    ++counts_.repeated;
    return false;
  }
  if (ahead > mask / 2) {
    ++counts_.restarts;  // less than before: the device restarted
    return true;
  }
  const auto sent =
      static_cast<std::uint64_t>(std::llround(static_cast<double>(ahead) / profile_.counter_step));
  if (sent > 1) counts_.lost += sent - 1;
  return true;
}

// INT64_MIN: the clock stands still.
std::int64_t PoseDecoder::time_of(std::uint8_t number, std::span<const std::uint8_t> report,
                                  std::int64_t arrival_ns) noexcept {
  std::int64_t t_ns = arrival_ns;
  if (clock_ && profile_.clock->report == number) {
    const std::uint64_t restarts = clock_->restarts();
    t_ns = clock_->host_ns(profile_.clock->bits_of(report), arrival_ns);
    counts_.restarts += clock_->restarts() - restarts;
    if (t_ns <= last_ns_) {
      ++counts_.repeated;
      return INT64_MIN;
    }
  } else if (last_ns_ != INT64_MIN) {
    // Reports that waited together were not measured together; half the usual interval keeps a guessed rate from
    // running ahead of time.
    t_ns = std::max(t_ns, last_ns_ + static_cast<std::int64_t>(0.5e9 / profile_.rate_hz));
  }
  last_ns_ = t_ns;
  return t_ns;
}

bool PoseDecoder::read_axes(const ToolProfile& tool, std::uint8_t number,
                            std::span<const std::uint8_t> report, Axes& axes) const noexcept {
  bool good = true, turned = false;
  const auto read = [&](const std::optional<ReportField>& field, double& value) {
    if (!field || field->report != number) return false;
    value = field->value(report);
    good = good && std::abs(value) <= kFarthest;  // a NaN is not
    return true;
  };
  for (std::size_t i = 0; i < 3; ++i) read(tool.position_fields[i], axes.position[i]);
  for (std::size_t i = 0; i < 4; ++i) turned = read(tool.rotation_fields[i], axes.rotation[i]) || turned;
  if (turned && good && tool.rotation == ToolProfile::Rotation::kQuaternion) good = near_unit(axes.rotation);
  for (const ToolProfile::Switch& button : tool.buttons) {
    if (button.field.report == number) axes.buttons &= ~(1u << button.button);
  }
  for (const ToolProfile::Switch& button : tool.buttons) {
    if (button.field.report == number && button.field.value(report) >= button.from)
      axes.buttons |= 1u << button.button;
  }
  return good;
}

void PoseDecoder::integrate(const ToolProfile& profile, Tool& tool, std::uint8_t number,
                            double dt_s) const noexcept {
  const auto& p = tool.axes.position;
  double step[3]{};
  for (std::size_t i = 0; i < 3; ++i) {
    if (profile.position == ToolProfile::Position::kRate) step[i] = profile.position_rate.speed(p[i]) * dt_s;
    const auto& field = profile.position_fields[i];
    if (profile.position == ToolProfile::Position::kRelative && field && field->report == number)
      step[i] = p[i];
  }
  const double reach = profile.position_reach;
  tool.place = {std::clamp(tool.place.x + step[0], -reach, reach),
                std::clamp(tool.place.y + step[1], -reach, reach),
                std::clamp(tool.place.z + step[2], -reach, reach)};
  if (profile.rotation == ToolProfile::Rotation::kRate) {
    const auto& r = tool.axes.rotation;
    const RateShape& shape = profile.rotation_rate;
    const Quat turn = turn_by(dt_s * Vec3{shape.speed(r[1]), shape.speed(r[2]), shape.speed(r[3])});
    tool.turn =
        (profile.rotation_in_tool_frame ? product(tool.turn, turn) : product(turn, tool.turn)).normalized();
  }
}

Quat PoseDecoder::rotation_of(const ToolProfile& profile, const Tool& tool) const noexcept {
  const auto& r = tool.axes.rotation;
  switch (profile.rotation) {
    case ToolProfile::Rotation::kNone:
      break;
    case ToolProfile::Rotation::kQuaternion:
      return near_unit(r) ? Quat{r[0], r[1], r[2], r[3]}.normalized() : Quat{};
    case ToolProfile::Rotation::kEuler: {
      Quat q;
      for (const std::uint8_t axis : profile.euler_order) {
        const Vec3 about{axis == 0 ? r[1] : 0, axis == 1 ? r[2] : 0, axis == 2 ? r[3] : 0};
        q = product(q, turn_by(about));
      }
      return q;
    }
    case ToolProfile::Rotation::kRate:
      return tool.turn;
  }
  return {};
}

core::Pose PoseDecoder::to_world(const Vec3& place, const Quat& turn) const noexcept {
  // With M the profile's axes, v -> M v for places and M R M^-1 for rotations, whose vector part is det(M) M v: right
  // for devices with left-handed axes, too.
  const auto& a = profile_.axes;
  const auto& s = profile_.signs;
  const auto map = [&](const Vec3& v) {
    return Vec3{s[0] * component(v, a[0]), s[1] * component(v, a[1]), s[2] * component(v, a[2])};
  };
  const bool even = (a[1] + 3 - a[0]) % 3 == 1;  // an even permutation of the axes
  const double det = (even ? 1 : -1) * s[0] * s[1] * s[2];
  const Vec3 axis = det * map({turn.x, turn.y, turn.z});
  core::Pose pose;
  pose.position =
      placement_.origin + core::rotate(placement_.rotation, (profile_.scale * placement_.scale) * map(place));
  pose.orientation = product(placement_.rotation, {turn.w, axis.x, axis.y, axis.z});
  return pose;
}

Vec3 PoseDecoder::device_from_world(const Vec3& force) const noexcept {
  const Quat& r = placement_.rotation;
  const Vec3 mapped = core::rotate({r.w, -r.x, -r.y, -r.z}, force);
  double device[3]{};
  for (std::size_t i = 0; i < 3; ++i) device[profile_.axes[i]] = profile_.signs[i] * component(mapped, i);
  return {device[0], device[1], device[2]};
}

Vec3 PoseDecoder::device_torque_from_world(const Vec3& torque) const noexcept {
  // The determinant of the map of axes: an even permutation has the same order around the circle.
  const bool even = (profile_.axes[0] + 1) % 3 == profile_.axes[1];
  const double mirrored = (even ? 1 : -1) * profile_.signs[0] * profile_.signs[1] * profile_.signs[2];
  return mirrored * device_from_world(torque);
}

}  // namespace incise::input
