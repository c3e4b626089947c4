#pragma once

#include <stdexcept>

namespace incise::client {

// Exit statuses of `incise` and `incised`. `incise cut` has one more, app::kNothingCut.
inline constexpr int kSuccess = 0;
inline constexpr int kFailed = 1;      // one line on the standard error says why
inline constexpr int kWrongUsage = 2;  // the command line is wrong, whatever files and servers hold

// A command line that is wrong: the program exits with kWrongUsage.
struct UsageError : std::invalid_argument {
  using std::invalid_argument::invalid_argument;
};

}  // namespace incise::client
