#include "server/app/offline/terminal.hpp"

#include <unistd.h>

#include <algorithm>
#include <cstdio>

namespace incise::app {

using std::chrono::steady_clock;

Progress::Progress(std::string label)
    : label_(std::move(label)),
      terminal_(isatty(STDERR_FILENO) == 1),
      start_(steady_clock::now()),
      shown_(start_) {}

Progress::~Progress() {
  if (drawn_) std::fprintf(stderr, "\r\033[K");
}

void Progress::show(double fraction, std::string_view detail) {
  const auto now = steady_clock::now();
  if (!terminal_ || now - start_ < std::chrono::seconds(1) || now - shown_ < std::chrono::milliseconds(100))
    return;
  shown_ = now;
  drawn_ = true;
  constexpr int kWidth = 30;
  std::string bar;
  if (fraction >= 0) {
    const int filled = static_cast<int>(kWidth * std::clamp(fraction, 0.0, 1.0));
    bar = " [" + std::string(filled, '#') + std::string(kWidth - filled, ' ') + "] " +
          std::to_string(static_cast<int>(100 * std::clamp(fraction, 0.0, 1.0))) + " %";
  }
  std::fprintf(stderr, "\r\033[K%s%s %.*s", label_.c_str(), bar.c_str(), static_cast<int>(detail.size()),
               detail.data());
  std::fflush(stderr);
}

void print_row(std::string_view name, const std::string& value) {
  std::printf("%-22.*s %s\n", static_cast<int>(name.size()), name.data(), value.c_str());
}

std::string short_number(double number) {
  char text[32];
  std::snprintf(text, sizeof text, "%.4g", number);
  return text;
}

}  // namespace incise::app
