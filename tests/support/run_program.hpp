#pragma once

#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <cstdlib>
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

// Runs a built program to its end, without a terminal. `arguments` are passed as they are.
inline RunResult run_program(const std::string& name, const std::vector<std::string>& arguments,
                             const std::filesystem::path& directory) {
  const auto quoted = [](const std::string& text) {
    std::string out = "'";
    for (const char c : text) out += c == '\'' ? std::string("'\\''") : std::string(1, c);
    return out + "'";
  };
  const auto err = directory / "stderr.txt", out = directory / "stdout.txt";
  std::string command =
      "cd " + quoted(directory.string()) + " && " + quoted(std::string(INCISE_BIN_DIR) + "/" + name);
  for (const std::string& argument : arguments) command += ' ' + quoted(argument);
  command += " > " + quoted(out.string()) + " 2> " + quoted(err.string()) + " < /dev/null";
  const int status = std::system(command.c_str());
  RunResult result;
  result.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  result.out = read_file(out);
  result.err = read_file(err);
  return result;
}

// An empty directory of this test's own, under the build's temporary directory.
inline std::filesystem::path fresh_directory(const std::string& name) {
  auto path = std::filesystem::temp_directory_path() / ("incise_" + name + "_" + std::to_string(::getpid()));
  std::filesystem::remove_all(path);
  std::filesystem::create_directories(path);
  return path;
}

}  // namespace incise::tests
