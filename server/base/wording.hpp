#pragma once

#include <cstdint>
#include <cstdio>
#include <string>
#include <string_view>

// Numbers as people read them, in messages and tables.
namespace incise {

// In few digits: "12.3", "0.00042".
inline std::string short_number(double number, int digits = 4) {
  char text[32];
  std::snprintf(text, sizeof text, "%.*g", digits, number);
  return text;
}

// A duration in a suitable unit: "840 us", "13.8 ms", "2.1 s".
inline std::string short_duration(double us) {
  char text[32];
  const bool milli = us >= 999.5, whole = us >= 999.5e3;
  std::snprintf(text, sizeof text, "%.3g %s",
                whole   ? us * 1e-6
                : milli ? us * 1e-3
                        : us,
                whole   ? "s"
                : milli ? "ms"
                        : "us");
  return text;
}

// "1 pose", "2 poses".
inline std::string counted(std::uint64_t n, std::string_view one, std::string_view many) {
  return std::to_string(n) + " " + std::string(n == 1 ? one : many);
}

}  // namespace incise
