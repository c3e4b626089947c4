#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace incise::mesh_io {

// How a child process ended.
struct ChildResult {
  enum class End { kExited, kSignalled, kTimedOut, kNotStarted } end = End::kNotStarted;
  int code = 0;            // exit code, signal number, or errno
  std::string last_stage;  // the last line it wrote that ended in "...", without the dots
  std::string last_line;   // the last line that it wrote
};

// Runs a program (looked up on the PATH if its name has no slash), reads what it writes, and kills it when
// its time is over. `on_stage` is called for each line that ends in "..." and twice a second: stage, seconds.
ChildResult run_child(const std::string& program, const std::vector<std::string>& arguments,
                      std::chrono::milliseconds time_limit,
                      const std::function<void(std::string_view, double)>& on_stage);

// The incise-tetgen to start; see fill_surface.
std::string tetgen_program(const std::filesystem::path& first = {});

// A new directory that only this user can enter; removed at the end with its contents.
class TemporaryDirectory {
 public:
  TemporaryDirectory();  // throws MeshError
  ~TemporaryDirectory();
  TemporaryDirectory(const TemporaryDirectory&) = delete;
  TemporaryDirectory& operator=(const TemporaryDirectory&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace incise::mesh_io
