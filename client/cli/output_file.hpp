#pragma once

#include <filesystem>
#include <stdexcept>
#include <string>
#include <system_error>

#include "server/base/directory_probe.hpp"

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
  if (const std::error_code why = why_no_file_can_be_made(parent)) {
    throw std::runtime_error(name + ": files cannot be made in " + parent.string() + " (" + why.message() +
                             "); choose another directory");
  }
}

}  // namespace incise::client
