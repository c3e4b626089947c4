#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <span>
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
// its time is over. `files`: descriptors that it has as well, under the same numbers. `on_stage` is called for each line that ends in "..." and twice a second: stage, seconds.
ChildResult run_child(const std::string& program, const std::vector<std::string>& arguments,
                      std::span<const int> files, std::chrono::milliseconds time_limit,
                      const std::function<void(std::string_view, double)>& on_stage);

// The incise-tetgen to start; see fill_surface.
std::string tetgen_program(const std::filesystem::path& first = {});

// A file in memory, without a name on any disk, to exchange with a child process. Nothing is left of it however both end, by a signal too: what is
// filled may be a patient's organ.
class MemoryFile {
 public:
  explicit MemoryFile(std::string_view bytes = {});  // throws MeshError
  ~MemoryFile();
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;
  int descriptor() const { return descriptor_; }
  // Names it in a process that has the descriptor.
  std::string path() const;
  // What was written there. Throws MeshError.
  std::string bytes() const;

 private:
  int descriptor_ = -1;
};

}  // namespace incise::mesh_io
