#pragma once

#include <csignal>

namespace incise::app {

// Blocks the signals that end the server, in this thread and in all threads that it starts, so that wait() gets them. Made
// before any other thread, the log's included: a signal goes to whichever thread does not block it, and ends the process there.
class EndSignals {
 public:
  EndSignals();
  // The signal's name; null after a second without one.
  const char* wait() const;
  // Whether one has come; wait() still gets it.
  bool pending() const;

 private:
  sigset_t set_;
};

}  // namespace incise::app
