#include "server/app/offline/terminal.hpp"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <utility>

namespace incise::app {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

Progress::Progress(std::string label)
    : Progress(std::move(label), stderr, isatty(STDERR_FILENO) == 1, std::chrono::seconds(1)) {}

Progress::Progress(std::string label, std::FILE* out, bool terminal, milliseconds delay)
    : out_(out), start_(steady_clock::now()), label_(std::move(label)) {
  if (terminal) drawing_ = std::jthread([this, delay](const std::stop_token& stop) { draw(stop, delay); });
}

Progress::~Progress() = default;

void Progress::stage(std::string label) {
  const std::scoped_lock lock(mutex_);
  label_ = std::move(label);
  detail_.clear();
  fraction_ = -1;
}

void Progress::show(double fraction, std::string_view detail) {
  const std::scoped_lock lock(mutex_);
  fraction_ = fraction;
  detail_ = detail;
}

void Progress::draw(const std::stop_token& stop, milliseconds delay) {
  std::unique_lock lock(mutex_);
  const auto stopped_within = [&](milliseconds time) {
    return stopped_.wait_for(lock, stop, time, [&] { return stop.stop_requested(); });
  };
  if (stopped_within(delay)) return;
  do {
    std::fprintf(out_, "\r\033[K%s", line().c_str());
    std::fflush(out_);
  } while (!stopped_within(milliseconds(100)));
  std::fprintf(out_, "\r\033[K");
  std::fflush(out_);
}

std::string Progress::line() const {
  constexpr int kWidth = 30;
  std::string text = label_;
  if (fraction_ >= 0) {
    const double part = std::clamp(fraction_, 0.0, 1.0);
    const int filled = static_cast<int>(kWidth * part);
    text += " [" + std::string(static_cast<std::size_t>(filled), '#') +
            std::string(static_cast<std::size_t>(kWidth - filled), ' ') + "] " +
            std::to_string(static_cast<int>(100 * part)) + " %";
  }
  if (!detail_.empty()) text += " " + detail_;
  const auto passed = std::chrono::duration_cast<std::chrono::seconds>(steady_clock::now() - start_);
  return text + " (" + std::to_string(passed.count()) + " s)";
}

void print_warnings(const std::vector<std::string>& warnings) {
  for (const std::string& warning : warnings) std::fprintf(stderr, "warning: %s\n", warning.c_str());
}

void print_row(std::string_view name, const std::string& value) {
  std::printf("%-22.*s %s\n", static_cast<int>(name.size()), name.data(), value.c_str());
}

}  // namespace incise::app
