#pragma once

#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <system_error>

namespace incise {

// Why no file can be made in a directory; no error where one can. It makes one and removes it again: permissions do not say all, as in /proc, or in a file
// system that is full of files or can only be read.
inline std::error_code why_no_file_can_be_made(const std::filesystem::path& directory) {
  std::string probe = (directory / "incise-check-XXXXXX").string();
  const int made = ::mkstemp(probe.data());
  if (made < 0) return {errno, std::generic_category()};
  ::close(made);
  ::unlink(probe.c_str());
  return {};
}

}  // namespace incise
