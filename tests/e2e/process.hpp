#pragma once

// A program of ours, run by a test.

#include <sys/types.h>

#include <cstdint>
#include <string>
#include <vector>

namespace incise::e2e {

class Process {
 public:
  // Starts build/bin/<arguments[0]>, or what that names where it is a whole path. What it writes to stdout comes by line(); stderr is the test's.
  explicit Process(std::vector<std::string> arguments);
  // Kills it where it still runs.
  ~Process();
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  // The next line that begins with `prefix`; empty at the end of its output or after `seconds`.
  std::string line(const std::string& prefix, double seconds = 60);
  // All that is left of its output.
  std::string rest();
  pid_t pid() const { return pid_; }
  void signal(int number);
  // Its exit code once it has ended; 128 + the signal that killed it; -1 after `seconds`.
  int wait(double seconds = 60);
  bool running();

 private:
  pid_t pid_ = -1;
  int out_ = -1;
  int status_ = -1;
  bool ended_ = false;
  std::string pending_;
};

// The port behind `key` ("tcp=", "http=", ...) in the line that incised prints when it listens; 0 if it is not there.
std::uint16_t port_after(const std::string& line, const std::string& key);

// Whether build/bin/<name> has been built.
bool have_program(const std::string& name);

}  // namespace incise::e2e
