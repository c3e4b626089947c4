#include "server/app/end_signals.hpp"

#include <array>
#include <ctime>
#include <utility>

namespace incise::app {
namespace {

constexpr std::array<std::pair<int, const char*>, 3> kEnds{
    {{SIGINT, "SIGINT"}, {SIGTERM, "SIGTERM"}, {SIGHUP, "SIGHUP"}}};

// As under nohup, which wants the server to outlive its terminal. Blocked, the signal would come all the same.
bool ignored(int signal) {
  struct sigaction now {};
  return sigaction(signal, nullptr, &now) == 0 && now.sa_handler == SIG_IGN;
}

}  // namespace

EndSignals::EndSignals() {
  sigemptyset(&set_);
  for (const auto& [signal, name] : kEnds) {
    if (signal != SIGHUP || !ignored(signal)) sigaddset(&set_, signal);
  }
  pthread_sigmask(SIG_BLOCK, &set_, nullptr);
  // A peer that has gone shows as an error of the write.
  std::signal(SIGPIPE, SIG_IGN);
  // So does a file that has reached its size limit; to the journal it is a full disk.
  std::signal(SIGXFSZ, SIG_IGN);
}

const char* EndSignals::wait() const {
  const timespec second{1, 0};
  const int come = sigtimedwait(&set_, nullptr, &second);
  for (const auto& [signal, name] : kEnds) {
    if (signal == come) return name;
  }
  return nullptr;
}

bool EndSignals::pending() const {
  sigset_t come{};
  if (sigpending(&come) != 0) return false;
  for (const auto& [signal, name] : kEnds) {
    if (sigismember(&set_, signal) == 1 && sigismember(&come, signal) == 1) return true;
  }
  return false;
}

}  // namespace incise::app
