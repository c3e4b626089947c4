#pragma once

// Checks of options' values. Each error is one line: what was found and what is accepted.

#include <CLI/CLI.hpp>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>

#include "protocol/limits.hpp"
#include "protocol/motion.hpp"

namespace incise::client {
namespace detail {

inline std::string refusal(const std::string& text, const std::string& accepted) {
  return "found " + text + "; accepted is " + accepted;
}

}  // namespace detail

// A number from `least` to `most`; without `most`, any from `least` on.
inline CLI::Validator number_from(double least, double most = std::numeric_limits<double>::infinity()) {
  const auto shown = [](double number) {
    std::string text = std::to_string(number);
    text.erase(text.find_last_not_of('0') + 1);
    if (text.ends_with('.')) text.pop_back();
    return text;
  };
  const std::string range =
      std::isinf(most) ? shown(least) + " or more" : shown(least) + " to " + shown(most);
  const std::string accepted = std::isinf(most) ? "a number, " + range : "a number from " + range;
  const auto check = [=](std::string& text) {
    double number = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    const bool whole = error == std::errc() && end == text.data() + text.size();
    const bool good = whole && std::isfinite(number) && number >= least && number <= most;
    return good ? std::string() : detail::refusal(text, accepted);
  };
  return {check, range};
}

// A whole number from `least` to `most`.
inline CLI::Validator whole_number(std::uint64_t least = 0,
                                   std::uint64_t most = std::numeric_limits<std::uint64_t>::max()) {
  const auto check = [=](std::string& text) {
    std::uint64_t number = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    const bool whole = end == text.data() + text.size() && error != std::errc::invalid_argument;
    if (whole && error == std::errc() && number >= least && number <= most) return std::string();
    // The largest number is worth telling only to someone who passed it.
    const bool small = least == 0 && !(whole && error == std::errc::result_out_of_range);
    return detail::refusal(
        text, small && most == std::numeric_limits<std::uint64_t>::max()
                  ? "a whole number, 0 or more"
                  : "a whole number from " + std::to_string(least) + " to " + std::to_string(most));
  };
  return {check, ""};
}

// A name that a message can carry.
inline CLI::Validator name_of_a_blade() {
  const auto check = [](std::string& text) {
    if (text.size() <= protocol::kMaxNameBytes) return std::string();
    return detail::refusal("a name of " + std::to_string(text.size()) + " bytes",
                           "one of at most " + std::to_string(protocol::kMaxNameBytes));
  };
  return {check, ""};
}

// A blade's edge; the option is called --blade.
inline CLI::Validator blade_edge() {
  const auto check = [](std::string& text) {
    try {
      protocol::parse_blade("--blade", text);
      return std::string();
    } catch (const protocol::MotionError& error) {
      return std::string(error.what()).substr(std::string_view("--blade: ").size());
    }
  };
  return {check, ""};
}

}  // namespace incise::client
