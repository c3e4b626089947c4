#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "server/core/geometry/vec3.hpp"
#include "server/input/hid/report_descriptor.hpp"
#include "server/input/hid/report_field.hpp"

namespace incise::input {

// A profile that cannot be used. One line: file, key, what was found, what is accepted.
struct ProfileError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

inline constexpr std::size_t kMaxTools = 4;  // of one device

// How a deflection of -1 ... 1 becomes a speed: 0 within dead_zone, then
// full * ((|d| - dead_zone) / (1 - dead_zone))^curve.
struct RateShape {
  double full = 0;  // m/s or rad/s at deflection 1
  double dead_zone = 0;
  double curve = 1;

  double speed(double deflection) const noexcept;
  friend bool operator==(const RateShape&, const RateShape&) = default;
};

// One thing that the hand holds: one blade.
struct ToolProfile {
  enum class Position : std::uint8_t {
    kAbsolute,  // the fields are metres
    kRate,      // the fields are deflections, integrated with `position_rate`
    kRelative,  // the fields are metres moved since the last report
  };
  enum class Rotation : std::uint8_t {
    kNone,
    kQuaternion,  // w x y z, of a length near 1
    kEuler,       // x y z: radians about the tool's axes, in the order `euler_order`
    kRate,        // x y z: deflections about the axes, integrated with `rotation_rate`
  };
  struct Switch {
    ReportField field;
    double from = 1;      // on at this value and above
    unsigned button = 0;  // for buttons: bit of Pose::buttons

    friend bool operator==(const Switch&, const Switch&) = default;
  };
  std::string name;  // "" if the device has one tool
  Position position = Position::kAbsolute;
  std::array<std::optional<ReportField>, 3> position_fields;
  RateShape position_rate;
  double position_reach = 0.25;  // kRate and kRelative: metres from the start, along each axis, at most
  Rotation rotation = Rotation::kNone;
  std::array<std::optional<ReportField>, 4> rotation_fields;  // w x y z
  RateShape rotation_rate;
  bool rotation_in_tool_frame = false;  // kRate: about the tool's own axes, as a gyroscope measures
  std::array<std::uint8_t, 3> euler_order{2, 1,
                                          0};  // axes in the order of rotation; each rotates the next ones
  std::vector<Switch> buttons;
  std::optional<Switch> valid;  // off: no pose (out of the tracker's sight)
  std::optional<Switch> home;   // on: an integrated position and rotation return to the start

  friend bool operator==(const ToolProfile&, const ToolProfile&) = default;
};

// Bytes sent as they are, the report's number first (0 if the device does not number its reports).
struct FixedReport {
  bool feature = false;  // else an output report
  int interface = -1;    // of the same device; -1: the one that poses come from
  std::vector<std::uint8_t> bytes;

  friend bool operator==(const FixedReport&, const FixedReport&) = default;
};

struct ForceProfile {
  double max_newtons = 0;  // > 0
  double rate_hz = 1000;
  std::vector<std::uint8_t> bytes;                       // of an output report, its number first
  std::array<std::optional<ReportField>, 3> components;  // newtons, device frame; fields of `bytes`
  std::vector<ReportField> magnitudes;                   // newtons: for rumble motors
  double max_newton_metres = 0;                          // 0: it makes no torque
  std::array<std::optional<ReportField>, 3> torque;      // newton metres, device frame

  friend bool operator==(const ForceProfile&, const ForceProfile&) = default;
};

// A kind of device: how to recognise it, what its reports mean, what to send to it.
struct DeviceProfile {
  std::string id;    // names its sources; the file's name without .json
  std::string file;  // "" if it was made from a descriptor
  std::string name;
  // How to recognise it: numbers of maker and product, or a vendor-defined usage, and perhaps the interface.
  std::optional<std::uint16_t> vendor, product, usage_page, usage;
  std::optional<int> interface;

  double rate_hz = 125;  // reports a second, about
  std::optional<ReportField> counter;
  double counter_step = 1;
  std::optional<ReportField> clock;  // its scale: seconds for a tick
  std::vector<ToolProfile> tools;
  // World from device: world axis i is sign * device axis; `scale` applies to all lengths.
  std::array<std::uint8_t, 3> axes{0, 1, 2};
  std::array<std::int8_t, 3> signs{1, 1, 1};
  double scale = 1;
  std::vector<FixedReport> start, stop;
  std::optional<ForceProfile> force;

  friend bool operator==(const DeviceProfile&, const DeviceProfile&) = default;
};

// Reads a profile: JSON with comments. Throws ProfileError. `name` is the file in messages; without folder and ending
// it is the profile's id.
DeviceProfile parse_profile(std::string_view text, const std::string& name);
DeviceProfile load_profile(const std::filesystem::path& file);
// All *.json of a folder, by name. Throws ProfileError for the first that is wrong.
std::vector<DeviceProfile> load_profiles(const std::filesystem::path& folder);

// Why a device with this descriptor does not fit the profile; empty if it does. A descriptor that calls its reports opaque
// bytes tells only their length.
std::string mismatch(const DeviceProfile& profile, const ReportDescriptor& descriptor);

// A profile for a device without one, from X ... Rz of the Generic Desktop page and its buttons. Values of a multi-axis
// controller are deflections; those of other devices are positions if they have a unit of length. Nothing, and the reason
// in `why`, if the device lacks X, Y or Z.
std::optional<DeviceProfile> profile_from(const ReportDescriptor& descriptor, std::string& why);
// Whether the descriptor says multi-axis controller: then profile_from() may be used without asking.
bool is_multi_axis(const ReportDescriptor& descriptor);

}  // namespace incise::input
