#pragma once

#include <chrono>
#include <cstdint>

namespace incise::stream {

// Counts what one peer sends, second by second.
//
// Thread: the stream thread.
class MessageRate {
 public:
  // More pose messages than any device sends.
  static constexpr std::uint32_t kMaxPoseMessagesPerSecond = 20'000;

  explicit MessageRate(std::uint32_t max_per_second) : max_per_second_(max_per_second) {}

  // A message has come. False where there are too many.
  bool allow(std::int64_t now_ns) {
    begin_second(now_ns);
    return ++messages_ <= max_per_second_;
  }
  // An operator's poses have come. How long to wait before they are used, and the next message read: too many are not
  // an error, the peer's own send buffer fills and it waits.
  std::chrono::milliseconds delay_poses(std::int64_t now_ns) {
    begin_second(now_ns);
    if (++pose_messages_ <= kMaxPoseMessagesPerSecond) return {};
    return std::chrono::milliseconds(1 + (kSecond_ns - (now_ns - second_ns_)) / 1'000'000);
  }

 private:
  static constexpr std::int64_t kSecond_ns = 1'000'000'000;

  void begin_second(std::int64_t now_ns) {
    if (now_ns - second_ns_ < kSecond_ns) return;
    second_ns_ = now_ns;
    messages_ = pose_messages_ = 0;
  }

  const std::uint32_t max_per_second_;
  std::int64_t second_ns_ = 0;  // when it began
  std::uint32_t messages_ = 0, pose_messages_ = 0;
};

}  // namespace incise::stream
