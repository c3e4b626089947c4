#pragma once

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

namespace incise::tests {

struct RunResult {
  int exit_code = -1;  // 128 + signal where one ended it
  std::string out, err;
};

inline std::string read_file(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

// A program that runs in `directory`, and where it prints.
struct Started {
  pid_t child = -1;
  std::filesystem::path out, err;
  std::string error;  // why it could not be started
};
// Starts a built program, without a terminal. `arguments` are passed as they are; `out` is its standard output.
inline Started start_program(const std::string& name, const std::vector<std::string>& arguments,
                             const std::filesystem::path& directory, const std::filesystem::path& out) {
  const auto err = directory / "stderr.txt";
  const std::string program = std::string(INCISE_BIN_DIR) + "/" + name;
  std::vector<char*> argv{const_cast<char*>(program.c_str())};
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  // Without a shell: none lives with a sanitizer's library preloaded.
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  constexpr int kAnew = O_WRONLY | O_CREAT | O_TRUNC;
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, out.c_str(), kAnew, 0644);
  posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, err.c_str(), kAnew, 0644);
  posix_spawn_file_actions_addchdir_np(&actions, directory.c_str());
  Started started{-1, out, err, {}};
  const int error = ::posix_spawn(&started.child, program.c_str(), &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (error != 0) started.error = program + ": " + std::strerror(error);
  return started;
}

// Waits for its end.
inline RunResult end_of(const Started& started) {
  if (!started.error.empty()) return {-1, {}, started.error};
  int status = 0;
  ::waitpid(started.child, &status, 0);
  RunResult result;
  result.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  if (std::filesystem::is_regular_file(started.out)) result.out = read_file(started.out);
  result.err = read_file(started.err);
  return result;
}

// Runs a built program to its end.
inline RunResult run_program(const std::string& name, const std::vector<std::string>& arguments,
                             const std::filesystem::path& directory) {
  return end_of(start_program(name, arguments, directory, directory / "stdout.txt"));
}

// An empty directory of this test's own, under the build's temporary directory.
inline std::filesystem::path fresh_directory(const std::string& name) {
  auto path = std::filesystem::temp_directory_path() / ("incise_" + name + "_" + std::to_string(::getpid()));
  std::filesystem::remove_all(path);
  std::filesystem::create_directories(path);
  return path;
}

}  // namespace incise::tests
