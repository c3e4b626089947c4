#include "server/app/end_signals.hpp"

#include <ctime>

namespace incise::app {

EndSignals::EndSignals() {
  sigemptyset(&set_);
  sigaddset(&set_, SIGINT);
  sigaddset(&set_, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &set_, nullptr);
  // A peer that has gone shows as an error of the write.
  std::signal(SIGPIPE, SIG_IGN);
  // So does a file that has reached its size limit; to the journal it is a full disk.
  std::signal(SIGXFSZ, SIG_IGN);
}

const char* EndSignals::wait() const {
  const timespec second{1, 0};
  const int signal = sigtimedwait(&set_, nullptr, &second);
  return signal == SIGINT ? "SIGINT" : signal == SIGTERM ? "SIGTERM" : nullptr;
}

bool EndSignals::pending() const {
  sigset_t come{};
  return sigpending(&come) == 0 && (sigismember(&come, SIGINT) == 1 || sigismember(&come, SIGTERM) == 1);
}

}  // namespace incise::app
