#include "server/app/capture_lock.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <system_error>

#include "server/app/config.hpp"

namespace incise::app {
namespace {

std::filesystem::path lock_file(std::filesystem::path capture) {
  capture += ".lock";
  return capture;
}

// One that another user's crash has left can be locked, too, though not written.
int open_file(const std::filesystem::path& file) {
  const int fd = ::open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0644);
  return fd < 0 && errno == EACCES ? ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW) : fd;
}

// 0, or the error.
int lock(int fd) {
  while (::flock(fd, LOCK_EX | LOCK_NB) != 0) {
    if (errno != EINTR) return errno;
  }
  return 0;
}

// Whoever had the lock before may have removed the file between our opening and locking it.
bool still_there(int fd, const std::filesystem::path& file) {
  struct stat ours {
  }, there{};
  return ::fstat(fd, &ours) == 0 && ::stat(file.c_str(), &there) == 0 && ours.st_dev == there.st_dev &&
         ours.st_ino == there.st_ino;
}

// A full disk costs the message of another server this number, nothing else.
void write_process(int fd) {
  const std::string text = std::to_string(::getpid()) + "\n";
  if (::ftruncate(fd, 0) == 0 && ::pwrite(fd, text.data(), text.size(), 0) < 0) return;
}

// " (process N)" of the one that has the lock; empty if it is not known.
std::string process_text(int fd) {
  std::array<char, 24> text{};
  const ssize_t n = ::pread(fd, text.data(), text.size(), 0);
  int process = 0;
  if (n <= 0 || std::from_chars(text.data(), text.data() + n, process).ec != std::errc()) return {};
  return " (process " + std::to_string(process) + ")";
}

}  // namespace

CaptureLock::CaptureLock(const std::filesystem::path& capture, IfHeld if_held, const std::string& setting)
    : file_(lock_file(capture)) {
  for (;;) {
    const int fd = open_file(file_);
    const int error = fd < 0 ? errno : lock(fd);
    if (error == 0 && still_there(fd, file_)) {
      write_process(fd);
      fd_ = fd;
      return;
    }
    const std::string process = error == EWOULDBLOCK ? process_text(fd) : "";
    if (fd >= 0) ::close(fd);
    if (error == 0) continue;
    if (error != EWOULDBLOCK) {
      trouble_ = file_.string() + ": cannot be locked: " + std::generic_category().message(error) +
                 "; nothing keeps another incised from writing the same capture";
      return;
    }
    if (if_held == IfHeld::kGoOn) return;
    throw ConfigError(setting + ": " + capture.string() + " is being written by another incised" + process +
                      "; give each its own");
  }
}

CaptureLock::~CaptureLock() {
  if (fd_ < 0) return;
  ::unlink(file_.c_str());  // while it is still locked: what comes after makes a new one
  ::close(fd_);
}

}  // namespace incise::app
