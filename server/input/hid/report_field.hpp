#pragma once

#include <cstdint>
#include <optional>
#include <span>

namespace incise::input {

// A number in a report: its place, its encoding and its meaning: value = scale * (raw - zero).
struct ReportField {
  enum class Kind : std::uint8_t { kUnsigned, kSigned, kFloat };
  std::uint8_t report = 0;  // the report's number; 0: the device does not number its reports
  std::uint32_t bit = 0;    // from the first bit of the report as it is read, its number included
  std::uint8_t bits = 16;   // 1 ... 32; kFloat: 32 or 64
  Kind kind = Kind::kSigned;
  bool big_endian = false;  // whole bytes only
  double scale = 1, zero = 0;

  // Bytes that a report needs to hold it.
  std::uint32_t end() const { return (bit + bits + 7) / 8; }
  // Of a report of at least end() bytes. A float may be NaN.
  double raw(std::span<const std::uint8_t> report_bytes) const noexcept;
  double value(std::span<const std::uint8_t> report_bytes) const noexcept {
    return scale * (raw(report_bytes) - zero);
  }
  // The raw number, for counters and clocks: integers only, not sign-extended.
  std::uint64_t bits_of(std::span<const std::uint8_t> report_bytes) const noexcept;
  // Writes the raw number nearest to value / scale + zero that its type can hold; NaN as 0.
  void write(std::span<std::uint8_t> report_bytes, double value) const noexcept;

  friend bool operator==(const ReportField&, const ReportField&) = default;
};

}  // namespace incise::input
