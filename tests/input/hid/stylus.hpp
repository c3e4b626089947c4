#pragma once

// What a Reference Stylus says, for tests that play one.

#include <cmath>
#include <cstring>
#include <span>

#include "protocol/hid/incise_stylus.h"
#include "server/core/stroke/blade.hpp"
#include "tests/support/mock_hid.hpp"

namespace incise::tests {

inline const Bytes& stylus_descriptor() {
  static const Bytes bytes{INCISE_STYLUS_REPORT_DESCRIPTOR};
  return bytes;
}

inline incise_stylus_input stylus_report(std::uint16_t counter, const core::Vec3& p,
                                         std::uint16_t buttons = 0) {
  const auto nm = [](double metres) { return static_cast<std::int32_t>(std::lround(metres * 1e9)); };
  incise_stylus_input report{};
  report.report = INCISE_STYLUS_INPUT;
  report.flags = INCISE_STYLUS_VALID;
  report.counter = counter;
  report.time_us = 1000u * counter;
  report.position[0] = nm(p.x);
  report.position[1] = nm(p.y);
  report.position[2] = nm(p.z);
  report.rotation[0] = 1 << 30;
  report.buttons = buttons;
  return report;
}

template <class Report>
std::span<const std::uint8_t> bytes_of(const Report& report) {
  return {reinterpret_cast<const std::uint8_t*>(&report), sizeof report};
}

inline MockDevice::Kind stylus(const std::string& serial = "S1", int hidraw = 0, int port = 1) {
  MockDevice::Kind kind;
  kind.name = "Stylus";
  kind.serial = serial;
  kind.descriptor = stylus_descriptor();
  kind.hidraw = hidraw;
  kind.port = port;
  return kind;
}

}  // namespace incise::tests
