#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <mutex>
#include <stop_token>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

namespace incise::app {

// A progress bar on stderr, if that is a terminal, for work that takes longer than a second; it disappears when done.
//
// Thread: any may call stage() and show(). Owns: a thread that draws, if there is a terminal, so that time is seen to pass
// even in a step that does not report progress.
class Progress {
 public:
  explicit Progress(std::string label);
  // Draws on `out` if `terminal` is set, first after `delay`.
  Progress(std::string label, std::FILE* out, bool terminal, std::chrono::milliseconds delay);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  // Names the work from here on; its progress is not known yet.
  void stage(std::string label);
  // `fraction` of 1, or less than 0 if unknown; `detail` is shown after the bar.
  void show(double fraction, std::string_view detail = {});

 private:
  void draw(const std::stop_token& stop, std::chrono::milliseconds delay);
  std::string line() const;

  std::FILE* const out_;
  const std::chrono::steady_clock::time_point start_;
  std::mutex mutex_;  // guards what follows
  std::condition_variable_any stopped_;
  std::string label_, detail_;
  double fraction_ = -1;
  std::jthread drawing_;  // last: it uses all of this
};

// "warning: ..." lines on stderr.
void print_warnings(const std::vector<std::string>& warnings);

// Rows of names and values, aligned, on stdout.
void print_row(std::string_view name, const std::string& value);

}  // namespace incise::app
