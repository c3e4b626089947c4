#pragma once

#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <string>
#include <system_error>
#include <utility>

namespace incise {

// A file under a temporary name beside its own, so that nobody sees half of it and what was there before stays until it is whole. The
// temporary one goes with this unless it got its own name. A link stays one: the file that it leads to is replaced.
class UnfinishedFile {
 public:
  explicit UnfinishedFile(const std::filesystem::path& path) : path_(target_of(path)), temporary_(path_) {
    static std::atomic<unsigned> count{0};  // two threads may write the same file
    temporary_ += ".tmp" + std::to_string(::getpid()) + "-" + std::to_string(count++);
  }
  UnfinishedFile(UnfinishedFile&& other) noexcept
      : path_(std::move(other.path_)), temporary_(std::exchange(other.temporary_, {})) {}
  UnfinishedFile(const UnfinishedFile&) = delete;
  UnfinishedFile& operator=(const UnfinishedFile&) = delete;
  ~UnfinishedFile() {
    std::error_code ignored;
    if (!temporary_.empty()) std::filesystem::remove(temporary_, ignored);
  }

  const std::filesystem::path& path() const { return path_; }
  // Where to write it.
  const std::filesystem::path& temporary() const { return temporary_; }
  // Once it is written and closed: gives it its own name.
  [[nodiscard]] std::error_code finish() {
    std::error_code error;
    std::filesystem::rename(temporary_, path_, error);
    if (!error) temporary_.clear();
    return error;
  }

 private:
  static std::filesystem::path target_of(const std::filesystem::path& path) {
    std::error_code error;
    if (!std::filesystem::is_symlink(path, error)) return path;
    std::filesystem::path target = std::filesystem::canonical(path, error);
    return error ? path : target;  // it leads nowhere
  }

  std::filesystem::path path_, temporary_;
};

}  // namespace incise
