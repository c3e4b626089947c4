#include "server/input/hid/report_field.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

namespace incise::input {
namespace {

// The bit of the report that holds bit b of the number: HID packs from the lowest bit of the first byte up.
std::uint32_t place(const ReportField& field, std::uint32_t b) {
  if (!field.big_endian) return field.bit + b;
  const std::uint32_t byte = field.bits / 8u - 1 - b / 8;
  return field.bit + 8 * byte + b % 8;
}

}  // namespace

std::uint64_t ReportField::bits_of(std::span<const std::uint8_t> report_bytes) const noexcept {
  std::uint64_t number = 0;
  if (bit % 8 == 0 && bits % 8 == 0) {
    const std::uint32_t first = bit / 8, count = bits / 8u;
    for (std::uint32_t i = 0; i < count; ++i) {
      const std::uint64_t byte = report_bytes[first + i];
      number |= byte << 8 * (big_endian ? count - 1 - i : i);
    }
    return number;
  }
  for (std::uint32_t b = 0; b < bits; ++b) {
    const std::uint32_t at = place(*this, b);
    number |= std::uint64_t{report_bytes[at / 8] >> at % 8 & 1u} << b;
  }
  return number;
}

double ReportField::raw(std::span<const std::uint8_t> report_bytes) const noexcept {
  const std::uint64_t number = bits_of(report_bytes);
  switch (kind) {
    case Kind::kFloat:
      return bits == 64 ? std::bit_cast<double>(number)
                        : std::bit_cast<float>(static_cast<std::uint32_t>(number));
    case Kind::kSigned: {
      const int unused = 64 - bits;
      return static_cast<double>(static_cast<std::int64_t>(number << unused) >> unused);
    }
    case Kind::kUnsigned:
      break;
  }
  return static_cast<double>(number);
}

void ReportField::write(std::span<std::uint8_t> report_bytes, double value) const noexcept {
  double wanted = value / scale + zero;
  if (!std::isfinite(wanted)) wanted = 0;
  std::uint64_t number = 0;
  if (kind == Kind::kFloat) {
    number = bits == 64 ? std::bit_cast<std::uint64_t>(wanted)
                        : std::bit_cast<std::uint32_t>(static_cast<float>(wanted));
  } else {
    const double top = std::ldexp(1.0, kind == Kind::kSigned ? bits - 1 : bits) - 1;
    const double low = kind == Kind::kSigned ? -top - 1 : 0;
    number =
        static_cast<std::uint64_t>(static_cast<std::int64_t>(std::nearbyint(std::clamp(wanted, low, top))));
  }
  for (std::uint32_t b = 0; b < bits; ++b) {
    const std::uint32_t at = place(*this, b);
    const auto mask = static_cast<std::uint8_t>(1u << at % 8);
    report_bytes[at / 8] = static_cast<std::uint8_t>(number >> b & 1 ? report_bytes[at / 8] | mask
                                                                     : report_bytes[at / 8] & ~mask);
  }
}

}  // namespace incise::input
