#pragma once

#include <chrono>
#include <string>
#include <string_view>

namespace incise::app {

// A progress bar on stderr, where that is a terminal, for what takes longer than a second; it goes away when done.
class Progress {
 public:
  explicit Progress(std::string label);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  // `fraction` of 1, or less than 0 where that is unknown; `detail` stands behind the bar.
  void show(double fraction, std::string_view detail = {});

 private:
  const std::string label_;
  const bool terminal_;
  const std::chrono::steady_clock::time_point start_;
  std::chrono::steady_clock::time_point shown_;
  bool drawn_ = false;
};

// Rows of names and values, aligned, on stdout.
void print_row(std::string_view name, const std::string& value);

// A number in few digits: "12.3", "0.00042".
std::string short_number(double number);

}  // namespace incise::app
