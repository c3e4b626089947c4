#pragma once

#include <filesystem>
#include <string>

namespace incise::app {

// Says that this process writes a capture, for as long as this lives: a lock of the kernel's on a file beside the capture,
// PATH.lock, which has the process's number. That file is removed at the end; what a crash leaves of it locks nobody out.
// The capture itself will not do: a start moves it away, and a session taken over replaces it. Readers need no lock.
class CaptureLock {
 public:
  // Where a lease says who writes (failover), the lock of an instance that only stands still must not keep others out.
  enum class IfHeld { kRefuse, kGoOn };
  // Takes the lock, before anything is done to the capture. Throws ConfigError if another process, or another CaptureLock
  // of this one, has it: the message calls the capture `setting`. Where files cannot be locked, goes on without; trouble()
  // says why.
  explicit CaptureLock(const std::filesystem::path& capture, IfHeld if_held = IfHeld::kRefuse,
                       const std::string& setting = "capture.path");
  ~CaptureLock();
  CaptureLock(const CaptureLock&) = delete;
  CaptureLock& operator=(const CaptureLock&) = delete;

  bool held() const { return fd_ >= 0; }
  const std::string& trouble() const { return trouble_; }

 private:
  const std::filesystem::path file_;
  int fd_ = -1;
  std::string trouble_;
};

}  // namespace incise::app
