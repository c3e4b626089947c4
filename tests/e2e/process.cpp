#include "tests/e2e/process.hpp"

#include <fcntl.h>
#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <stdexcept>
#include <thread>

namespace incise::e2e {
namespace {

using Clock = std::chrono::steady_clock;

std::string path_of(const std::string& name) {
  return std::string(INCISE_BIN_DIR) + "/" + name;
}

}  // namespace

std::uint16_t port_after(const std::string& line, const std::string& key) {
  const auto at = line.find(key);
  const auto colon = at == std::string::npos ? at : line.find(':', at);
  return colon == std::string::npos ? 0 : static_cast<std::uint16_t>(std::atoi(line.c_str() + colon + 1));
}

bool have_program(const std::string& name) {
  return ::access(path_of(name).c_str(), X_OK) == 0;
}

Process::Process(std::vector<std::string> arguments) {
  int pipe_ends[2];
  if (::pipe2(pipe_ends, O_CLOEXEC) != 0) throw std::runtime_error("pipe");
  if (arguments[0].front() != '/') arguments[0] = path_of(arguments[0]);
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  argv.push_back(nullptr);
  pid_ = ::fork();
  if (pid_ == 0) {
    ::dup2(pipe_ends[1], STDOUT_FILENO);
    ::execv(argv[0], argv.data());
    ::_exit(127);
  }
  ::close(pipe_ends[1]);
  out_ = pipe_ends[0];
}

Process::~Process() {
  if (running()) {
    signal(SIGKILL);
    wait();
  }
  ::close(out_);
}

std::string Process::line(const std::string& prefix, double seconds) {
  const auto end = Clock::now() + std::chrono::duration<double>(seconds);
  for (;;) {
    for (std::size_t at; (at = pending_.find('\n')) != std::string::npos;) {
      std::string found = pending_.substr(0, at);
      pending_.erase(0, at + 1);
      if (found.rfind(prefix, 0) == 0) return found;
    }
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(end - Clock::now()).count();
    pollfd ready{out_, POLLIN, 0};
    if (left <= 0 || ::poll(&ready, 1, static_cast<int>(left)) <= 0) return {};
    char buffer[4096];
    const ssize_t n = ::read(out_, buffer, sizeof buffer);
    if (n <= 0) return {};
    pending_.append(buffer, static_cast<std::size_t>(n));
  }
}

std::string Process::rest() {
  char buffer[4096];
  for (ssize_t n; (n = ::read(out_, buffer, sizeof buffer)) > 0;)
    pending_.append(buffer, static_cast<std::size_t>(n));
  return std::move(pending_);
}

void Process::signal(int number) {
  if (!ended_) ::kill(pid_, number);
}

bool Process::running() {
  if (!ended_ && ::waitpid(pid_, &status_, WNOHANG) == pid_) ended_ = true;
  return !ended_;
}

int Process::wait(double seconds) {
  const auto end = Clock::now() + std::chrono::duration<double>(seconds);
  while (running()) {
    if (Clock::now() > end) return -1;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return WIFEXITED(status_) ? WEXITSTATUS(status_) : 128 + WTERMSIG(status_);
}

}  // namespace incise::e2e
