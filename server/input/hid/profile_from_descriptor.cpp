// A profile made from a device's report descriptor alone.
#include <algorithm>
#include <array>
#include <cmath>

#include "server/input/hid/device_profile.hpp"

namespace incise::input {
namespace {

constexpr std::uint32_t kGenericDesktop = 1, kButtonPage = 9, kAxisX = 0x30, kAxisRz = 0x35,
                        kMultiAxis = 0x10008;

ReportField field_of(const DescribedField& described) {
  ReportField field;
  field.report = described.report_id;
  field.bit = described.bit;
  field.bits = described.bits;
  field.kind = described.logical_min < 0 ? ReportField::Kind::kSigned : ReportField::Kind::kUnsigned;
  return field;
}

// Metres for one step of the logical value; 0 if the unit is not one of length.
double metres_per_step(const DescribedField& field) {
  const std::uint32_t system = field.unit & 0xf;
  if ((field.unit & ~0xfu) != 0x10 || (system != 1 && system != 3)) return 0;
  const bool same = field.physical_min == 0 && field.physical_max == 0;
  const double logical = static_cast<double>(field.logical_max) - field.logical_min;
  const double physical = same ? logical : static_cast<double>(field.physical_max) - field.physical_min;
  if (!(logical > 0) || !(physical > 0)) return 0;
  return (system == 1 ? 0.01 : 0.0254) * std::pow(10.0, field.unit_exponent) * physical / logical;
}

}  // namespace

bool is_multi_axis(const ReportDescriptor& descriptor) {
  return std::find(descriptor.applications.begin(), descriptor.applications.end(), kMultiAxis) !=
         descriptor.applications.end();
}

std::optional<DeviceProfile> profile_from(const ReportDescriptor& descriptor, std::string& why) {
  std::array<const DescribedField*, 6> axes{};
  DeviceProfile profile;
  profile.tools.resize(1);
  ToolProfile& tool = profile.tools[0];
  for (const DescribedField& field : descriptor.fields) {
    if (field.kind != DescribedField::Kind::kInput) continue;
    const std::uint32_t page = field.usage >> 16, usage = field.usage & 0xffff;
    if (page == kGenericDesktop && usage >= kAxisX && usage <= kAxisRz &&
        field.logical_min < field.logical_max) {
      auto& axis = axes[usage - kAxisX];
      if (!axis) axis = &field;
    } else if (page == kButtonPage && usage >= 1 && usage <= 32) {
      tool.buttons.push_back({field_of(field), 1, usage - 1});
    }
  }
  if (!axes[0] || !axes[1] || !axes[2]) {
    why = "it does not describe X, Y and Z of the Generic Desktop page";
    return std::nullopt;
  }
  bool deflections = is_multi_axis(descriptor);
  for (std::size_t i = 0; i < 3; ++i) deflections = deflections || metres_per_step(*axes[i]) == 0;
  tool.position = deflections         ? ToolProfile::Position::kRate
                  : axes[0]->relative ? ToolProfile::Position::kRelative
                                      : ToolProfile::Position::kAbsolute;
  const auto deflection = [](const DescribedField& described) {
    ReportField field = field_of(described);
    const double low = described.logical_min, high = described.logical_max;
    field.zero = (low + high) / 2;
    field.scale = 2 / (high - low);
    return field;
  };
  for (std::size_t i = 0; i < 3; ++i) {
    tool.position_fields[i] = deflections ? deflection(*axes[i]) : field_of(*axes[i]);
    if (!deflections) tool.position_fields[i]->scale = metres_per_step(*axes[i]);
    if (axes[3 + i]) {
      tool.rotation = ToolProfile::Rotation::kRate;
      tool.rotation_fields[1 + i] = deflection(*axes[3 + i]);
    }
  }
  // Slow enough to aim with: 0.1 m/s and 1 rad/s at full deflection.
  tool.position_rate = {0.1, 0.05, 2};
  tool.rotation_rate = {1, 0.05, 2};
  return profile;
}

}  // namespace incise::input
