#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace incise::input {

// What a HID device says about its reports: the report descriptor (USB Device Class Definition for HID 1.11, section
// 6.2.2), as far as a pose needs it. One entry for each Input, Output or Feature element that has a usage.
struct DescribedField {
  enum class Kind : std::uint8_t { kInput, kOutput, kFeature };
  Kind kind = Kind::kInput;
  std::uint8_t report_id = 0;     // 0: the device does not number its reports
  std::uint32_t bit = 0;          // from the first bit of the report as it is read, its number included
  std::uint8_t bits = 0;          // 1 ... 32
  std::uint32_t usage = 0;        // page << 16 | usage
  std::uint32_t application = 0;  // usage of the application collection around it
  std::int32_t logical_min = 0, logical_max = 0;
  std::int32_t physical_min = 0, physical_max = 0;  // both 0: the same as the logical ones
  std::uint32_t unit = 0;                           // 6.2.2.7: nibbles of system, length, mass, time, ...
  std::int8_t unit_exponent = 0;
  bool relative = false;
};

struct ReportDescriptor {
  struct Report {
    DescribedField::Kind kind;
    std::uint8_t id;
    std::uint32_t bytes;  // of the report as it is read, its number included
  };
  std::vector<DescribedField> fields;
  std::vector<Report> reports;
  std::vector<std::uint32_t> applications;  // usages of the top-level collections

  bool numbered() const { return !reports.empty() && reports.front().id != 0; }
  // Bytes of that report; 0 if the device has none.
  std::uint32_t bytes_of(DescribedField::Kind kind, std::uint8_t id) const;
};

// Limits of a descriptor; real ones are far below.
inline constexpr std::size_t kMaxDescriptorBytes = 4096;  // the kernel's HID_MAX_DESCRIPTOR_SIZE
inline constexpr std::size_t kMaxDescribedFields = 4096;
inline constexpr std::uint32_t kMaxReportBytes = 16384;  // the kernel's HID_MAX_BUFFER_SIZE

// Reads untrusted bytes. Nothing, and the reason in `error`, if they are not a descriptor or exceed the limits above.
// O(bytes + fields).
std::optional<ReportDescriptor> parse_report_descriptor(std::span<const std::uint8_t> bytes,
                                                        std::string& error);

}  // namespace incise::input
