#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "server/core/stroke/blade.hpp"
#include "server/input/hid/device_clock.hpp"
#include "server/input/hid/device_profile.hpp"
#include "server/input/placement.hpp"

namespace incise::input {

// What became of a device's reports since it was opened.
struct ReportCounts {
  std::uint64_t reports = 0;     // all that arrived
  std::uint64_t lost = 0;        // that were lost, by the device's counter
  std::uint64_t short_ones = 0;  // too short for the profile's fields, and ignored
  std::uint64_t other = 0;       // with a number that the profile does not name, and ignored
  std::uint64_t repeated = 0;    // with the last one's counter or clock, and ignored: the device hangs
  std::uint64_t bad_values = 0;  // with numbers that cannot be a pose, and ignored
  std::uint64_t restarts = 0;    // of the device's counter or clock
};

// Turns a device's reports into poses. The source time of a pose is CLOCK_MONOTONIC when the device measured it, if its
// clock tells that, else when it arrived. It always rises.
//
// Thread: one. Allocates nothing after construction. O(fields of the profile) a report.
class PoseDecoder {
 public:
  // Of one tool, after a report.
  struct Sample {
    std::size_t tool = 0;
    bool valid = true;  // false: out of sight; no pose, and a stroke ends
    core::Pose pose;
  };

  PoseDecoder(const DeviceProfile& profile, const Placement& placement);

  // The samples in a report, valid until the next call; none if it was ignored.
  std::span<const Sample> decode(std::span<const std::uint8_t> report, std::int64_t arrival_ns) noexcept;

  const ReportCounts& counts() const noexcept { return counts_; }
  double drift_ppm() const noexcept { return clock_ ? clock_->drift_ppm() : 0; }
  // A force in the world, in the device's own axes.
  core::Vec3 device_from_world(const core::Vec3& force) const noexcept;
  // A torque likewise: in mirrored axes it turns the other way.
  core::Vec3 device_torque_from_world(const core::Vec3& torque) const noexcept;
  // The values of a tool's fields in the last report that had them, before integration: for displays.
  struct Axes {
    std::array<double, 3> position{};
    std::array<double, 4> rotation{};
    std::uint32_t buttons = 0;
  };
  const Axes& axes(std::size_t tool) const noexcept { return tools_[tool].axes; }

 private:
  struct Tool {
    Axes axes;
    core::Vec3 place;  // if integrated or relative: from the start, device axes, metres
    core::Quat turn;
    std::int64_t t_ns = 0;  // of the last sample
    bool valid = true;
    std::uint64_t reports[4]{};  // set of the report numbers with fields
  };

  std::uint32_t need_of(std::uint8_t report) const noexcept { return need_[report]; }
  bool follow_counter(std::uint8_t number, std::span<const std::uint8_t> report) noexcept;
  std::int64_t time_of(std::uint8_t number, std::span<const std::uint8_t> report,
                       std::int64_t arrival_ns) noexcept;
  bool read_axes(const ToolProfile& tool, std::uint8_t number, std::span<const std::uint8_t> report,
                 Axes& axes) const noexcept;
  void integrate(const ToolProfile& profile, Tool& tool, std::uint8_t number, double dt_s) const noexcept;
  core::Quat rotation_of(const ToolProfile& profile, const Tool& tool) const noexcept;
  core::Pose to_world(const core::Vec3& place, const core::Quat& turn) const noexcept;

  const DeviceProfile profile_;
  const Placement placement_;
  const bool numbered_;
  std::array<std::uint32_t, 256> need_{};  // bytes that a report of this number needs; 0: it has no fields
  std::optional<DeviceClock> clock_;
  std::optional<std::uint64_t> last_count_;
  std::int64_t last_ns_ = INT64_MIN;  // the last source time
  std::vector<Tool> tools_;
  std::array<Sample, kMaxTools> samples_;
  ReportCounts counts_;
};

}  // namespace incise::input
