#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

namespace incise::haptics {

// The newest value from one thread for another. Nobody ever waits: a triple buffer, in which the two sides swap their own
// buffer for the one in the middle. A value that was not read before the next is written is lost, by intent.
//
// Thread: one writer and one reader at a time; one that takes over from another must come after it (joined).
template <class Value>
class Latest {
 public:
  // The writer's: makes `value` the newest.
  void write(const Value& value) noexcept {
    buffers_[back_].value = value;
    back_ = middle_.exchange(static_cast<std::uint8_t>(back_ | kFresh), std::memory_order_acq_rel) & kIndex;
  }
  // The reader's: sets `newest` to the newest value. False, and `newest` is as it was, where nothing was written since the
  // last call.
  bool read(Value& newest) noexcept {
    if ((middle_.load(std::memory_order_relaxed) & kFresh) == 0) return false;
    front_ = middle_.exchange(front_, std::memory_order_acq_rel) & kIndex;
    newest = buffers_[front_].value;
    return true;
  }

 private:
  static constexpr std::uint8_t kIndex = 3, kFresh = 4;
  static constexpr std::size_t kCacheLine = 64;
  struct alignas(kCacheLine) Buffer {
    Value value;
  };
  Buffer buffers_[3];
  alignas(kCacheLine) std::uint8_t back_ = 0;                // the writer's buffer
  alignas(kCacheLine) std::uint8_t front_ = 1;               // the reader's
  alignas(kCacheLine) std::atomic<std::uint8_t> middle_{2};  // the buffer between them, | kFresh when unread
};

}  // namespace incise::haptics
