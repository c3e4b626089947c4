#pragma once

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>

namespace incise {

// Ends what `program` prints: at the end of its main, which returns what this does. That is `status`, or where the standard output could not be
// written to its end, as on a full disk, EXIT_FAILURE, after one line on the standard error that says so.
inline int end_standard_output(const char* program, int status) {
  errno = 0;
  const bool failed_before = std::ferror(stdout) != 0;
  if (std::fflush(stdout) == 0 && !failed_before) return status;
  std::fprintf(stderr, "%s: the standard output could not be written to its end%s%s\n", program,
               errno != 0 ? ": " : "", errno != 0 ? std::strerror(errno) : "");
  return EXIT_FAILURE;
}

}  // namespace incise
