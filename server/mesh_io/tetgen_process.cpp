#include "server/mesh_io/tetgen_process.hpp"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <thread>

#include "server/mesh_io/mesh_error.hpp"

namespace incise::mesh_io {
namespace {

using Clock = std::chrono::steady_clock;
constexpr std::chrono::milliseconds kTick{500};

// Keeps the last lines of what the child writes.
class StageReader {
 public:
  StageReader(ChildResult& result, const std::function<void()>& on_stage)
      : result_(result), on_stage_(on_stage) {}

  void add(std::string_view bytes) {
    for (const char c : bytes) {
      if (c == '\n') {
        finish_line();
      } else if (line_.size() < 300 && c >= ' ' && c <= '~') {
        line_ += c;
      }
    }
  }
  void finish_line() {
    while (!line_.empty() && line_.back() == ' ') line_.pop_back();
    if (line_.ends_with("...")) {
      result_.last_stage = line_.substr(0, line_.find_last_not_of(". ") + 1);
      if (!result_.last_stage.empty() && result_.last_stage[0] >= 'A' && result_.last_stage[0] <= 'Z') {
        result_.last_stage[0] = static_cast<char>(result_.last_stage[0] + ('a' - 'A'));
      }
      on_stage_();
    }
    if (!line_.empty()) result_.last_line = line_;
    line_.clear();
  }

 private:
  ChildResult& result_;
  const std::function<void()>& on_stage_;
  std::string line_;
};

void note_status(int status, ChildResult& result) {
  if (WIFSIGNALED(status)) {
    result.end = ChildResult::End::kSignalled;
    result.code = WTERMSIG(status);
  } else {
    result.end = ChildResult::End::kExited;
    result.code = WEXITSTATUS(status);
  }
}

}  // namespace

ChildResult run_child(const std::string& program, const std::vector<std::string>& arguments,
                      std::span<const int> files, std::chrono::milliseconds time_limit,
                      const std::function<void(std::string_view, double)>& on_stage) {
  ChildResult result;
  int pipe_ends[2];
  if (pipe2(pipe_ends, O_CLOEXEC) != 0) {
    result.code = errno;
    return result;
  }
  std::vector<char*> argv{const_cast<char*>(program.c_str())};
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, pipe_ends[1], STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, pipe_ends[1], STDERR_FILENO);
  // Onto itself: it stays open in the child.
  for (const int file : files) posix_spawn_file_actions_adddup2(&actions, file, file);
  // The server blocks signals in its threads. The child must not inherit that.
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  sigset_t none;
  sigemptyset(&none);
  posix_spawnattr_setsigmask(&attributes, &none);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK);
  pid_t child = -1;
  result.code = posix_spawnp(&child, program.c_str(), &actions, &attributes, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  posix_spawnattr_destroy(&attributes);
  close(pipe_ends[1]);
  if (result.code != 0) {
    close(pipe_ends[0]);
    return result;
  }

  const auto start = Clock::now();
  const auto deadline = start + time_limit;
  const std::function<void()> report = [&] {
    if (on_stage) on_stage(result.last_stage, std::chrono::duration<double>(Clock::now() - start).count());
  };
  StageReader reader(result, report);
  int status = 0;
  bool writing = true;
  while (true) {
    const auto now = Clock::now();
    if (now >= deadline) {
      kill(child, SIGKILL);
      waitpid(child, &status, 0);
      result.end = ChildResult::End::kTimedOut;
      break;
    }
    if (writing) {
      const auto left = std::min<Clock::duration>(deadline - now, kTick);
      pollfd ready{pipe_ends[0], POLLIN, 0};
      const int events =
          poll(&ready, 1, static_cast<int>(std::chrono::ceil<std::chrono::milliseconds>(left).count()));
      if (events == 0) report();
      if (events <= 0) continue;
      char buffer[4096];
      const ssize_t count = read(pipe_ends[0], buffer, sizeof buffer);
      if (count > 0) reader.add({buffer, static_cast<std::size_t>(count)});
      if (count == 0 || (count < 0 && errno != EINTR)) writing = false;
    } else if (waitpid(child, &status, WNOHANG) == child) {
      reader.finish_line();
      note_status(status, result);
      break;
    } else {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  }
  close(pipe_ends[0]);
  return result;
}

std::string tetgen_program(const std::filesystem::path& first) {
  if (const char* given = std::getenv("INCISE_TETGEN"); given && *given) return given;
  std::error_code error;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
  for (const auto& directory : {first, self.parent_path()}) {
    const auto program = directory / "incise-tetgen";
    if (!directory.empty() && std::filesystem::exists(program, error)) return program;
  }
  return "incise-tetgen";
}

namespace {

[[noreturn]] void fail_memory_file(const char* what) {
  throw MeshError(std::string("a file in memory, for TetGen, cannot be ") + what + ": " +
                  std::strerror(errno));
}

}  // namespace

MemoryFile::MemoryFile(std::string_view bytes) {
  const int made = memfd_create("incise-fill", MFD_CLOEXEC);
  if (made < 0) fail_memory_file("made");
  // Not one of the standard descriptors, which the child has for others.
  descriptor_ = fcntl(made, F_DUPFD_CLOEXEC, STDERR_FILENO + 1);
  const int error = errno;
  close(made);
  errno = error;
  if (descriptor_ < 0) fail_memory_file("made");
  for (std::size_t at = 0; at < bytes.size();) {
    const ssize_t count = write(descriptor_, bytes.data() + at, bytes.size() - at);
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) {
      close(descriptor_);
      fail_memory_file("written");
    }
    at += static_cast<std::size_t>(count);
  }
}

MemoryFile::~MemoryFile() {
  close(descriptor_);
}

std::string MemoryFile::path() const {
  return "/proc/self/fd/" + std::to_string(descriptor_);
}

std::string MemoryFile::bytes() const {
  struct stat status = {};
  if (fstat(descriptor_, &status) != 0) fail_memory_file("read");
  std::string bytes(static_cast<std::size_t>(status.st_size), '\0');
  for (std::size_t at = 0; at < bytes.size();) {
    const ssize_t count = pread(descriptor_, bytes.data() + at, bytes.size() - at, static_cast<off_t>(at));
    if (count < 0 && errno == EINTR) continue;
    if (count <= 0) fail_memory_file("read");
    at += static_cast<std::size_t>(count);
  }
  return bytes;
}

}  // namespace incise::mesh_io
