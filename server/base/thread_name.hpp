#pragma once

#include <pthread.h>

namespace incise {

// What `top -H` and /proc call the calling thread; at most 15 letters.
inline void name_thread(const char* name) {
  pthread_setname_np(pthread_self(), name);
}

}  // namespace incise
