#include "server/loop/realtime.hpp"

#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>

namespace incise::loop {
namespace {

std::string reason(int error) {
  return std::generic_category().message(error);
}

}  // namespace

std::string request_priority(int priority) {
  sched_param parameters{};
  parameters.sched_priority = priority;
  const int error = pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameters);
  const std::string wish = "real-time priority " + std::to_string(priority);
  if (error == 0) return wish + " granted (SCHED_FIFO)";
  return wish + " not granted: " + reason(error) +
         "; give the user LimitRTPRIO (systemd) or rtprio (/etc/security/limits.conf) of " +
         std::to_string(priority) + " or more, or set loop.realtime_priority to 0";
}

std::string request_cpu(int cpu) {
  cpu_set_t set;
  CPU_ZERO(&set);
  CPU_SET(static_cast<std::size_t>(cpu), &set);
  const int error = pthread_setaffinity_np(pthread_self(), sizeof set, &set);
  const std::string wish = "processor " + std::to_string(cpu);
  if (error == 0) return wish + " granted: the loop's thread stays there";
  return wish + " not granted: " + reason(error) + "; set loop.cpu to one of 0 to " +
         std::to_string(sysconf(_SC_NPROCESSORS_ONLN) - 1) + ", or to -1 for any";
}

std::string request_locked_memory() {
  // Where the limit is finite, a lock that is granted now would make some later allocation fail.
  rlimit limit{};
  getrlimit(RLIMIT_MEMLOCK, &limit);
  const std::string remedy =
      "; give the user LimitMEMLOCK=infinity (systemd) or memlock unlimited "
      "(/etc/security/limits.conf), or set loop.lock_memory to false";
  if (limit.rlim_cur != RLIM_INFINITY && geteuid() != 0) {
    return "locked memory not granted: the limit is " + std::to_string(limit.rlim_cur / 1024) + " kB" +
           remedy;
  }
  if (mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0)
    return "locked memory granted: nothing is swapped out";
  return "locked memory not granted: " + reason(errno) + remedy;
}

}  // namespace incise::loop
