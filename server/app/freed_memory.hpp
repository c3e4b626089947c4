#pragma once

#if defined(__GLIBC__)
#include <malloc.h>
#endif

namespace incise::app {

// From here on large arrays go back to the system when they are freed; what is free now goes at once. Without this glibc raises the size
// from which they do, up to 32 MB, after the first one was freed: then what a start, a snapshot and a long session need for a while
// stays with the process. It saves a start time, though: what it frees while it reads a file is used again soon.
inline void return_freed_memory() {
#if defined(__GLIBC__)
  constexpr int kLarge_bytes = 4 << 20;
  mallopt(M_MMAP_THRESHOLD, kLarge_bytes);
  malloc_trim(0);
#endif
}

}  // namespace incise::app
