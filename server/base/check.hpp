#pragma once

#include <cstdio>
#include <cstdlib>
#include <sstream>
#include <string>

// INCISE_CHECK(condition, value...): an assertion against a bug of ours. It stays on in release builds, prints
// the values that it is given, and ends the process. Not for input: untrusted bytes get an error code.
#define INCISE_CHECK(condition, ...)                                                                  \
  do {                                                                                                \
    if (!(condition)) [[unlikely]] {                                                                  \
      ::incise::check_failed(__FILE__, __LINE__, #condition __VA_OPT__(, #__VA_ARGS__, __VA_ARGS__)); \
    }                                                                                                 \
  } while (false)

namespace incise {

template <class... Values>
[[noreturn, gnu::cold, gnu::noinline]] void check_failed(const char* file, int line, const char* condition,
                                                         const char* names = "", const Values&... values) {
  std::ostringstream text;
  text << file << ':' << line << ": check failed: " << condition;
  if constexpr (sizeof...(values) > 0) {
    text << " (" << names << " =";
    ((text << ' ' << values), ...);
    text << ')';
  }
  std::fprintf(stderr, "%s\n", text.str().c_str());
  std::abort();
}

}  // namespace incise
