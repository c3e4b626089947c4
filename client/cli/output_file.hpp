#pragma once

#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <system_error>

namespace incise::client {

// Before the work whose result goes there, which may be hours. Throws std::runtime_error, with the option and what to do, if `path` cannot become a
// file.
inline void require_can_be_file(const std::string& option, const std::filesystem::path& path) {
  namespace fs = std::filesystem;
  std::error_code error;
  const std::string name = option + " " + path.string();
  const fs::path parent = path.has_parent_path() ? path.parent_path() : ".";
  if (!fs::is_directory(parent, error)) {
    throw std::runtime_error(name + ": the directory " + parent.string() +
                             " does not exist; make it first (mkdir -p " + parent.string() + ")");
  }
  if (!path.has_filename() || fs::is_directory(path, error))
    throw std::runtime_error(name + ": is a directory; accepted is a file's name");
  if (fs::exists(path, error)) return;
  // Permissions do not say all: /proc, or a file system that can only be read.
  std::string probe = (parent / "incise-check-XXXXXX").string();
  const int made = ::mkstemp(probe.data());
  if (made < 0) {
    throw std::runtime_error(name + ": files cannot be made in " + parent.string() + " (" +
                             std::generic_category().message(errno) + "); choose another directory");
  }
  ::close(made);
  ::unlink(probe.c_str());
}

}  // namespace incise::client
