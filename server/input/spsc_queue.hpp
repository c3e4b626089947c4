#pragma once

#include <algorithm>
#include <atomic>
#include <bit>
#include <cstddef>
#include <memory>
#include <span>
#include <utility>

namespace incise::input {

// A bounded queue between two threads: one pushes, one pops, neither ever waits, locks or allocates (Lamport
// 1983, "Specifying concurrent program modules", with each side's copy of the other's index kept on its own
// cache line so that the line is fetched only when the queue looks full or empty). Full is an answer, not an
// error: what to do then is up to the caller.
//
// Thread: push() from one thread, pop() from one thread; size(), pushed() and popped() from any.
template <class T>
class SpscQueue {
 public:
  // Room for `capacity` elements, rounded up to a power of two.
  explicit SpscQueue(std::size_t capacity)
      : mask_(std::bit_ceil(std::max<std::size_t>(capacity, 2)) - 1),
        slots_(std::make_unique<T[]>(mask_ + 1)) {}
  SpscQueue(const SpscQueue&) = delete;
  SpscQueue& operator=(const SpscQueue&) = delete;

  std::size_t capacity() const { return mask_ + 1; }

  // Appends as many of `values` as there is room for, in order, all at once; returns how many.
  std::size_t push(std::span<const T> values) {
    const std::size_t tail = tail_.load(std::memory_order_relaxed);
    if (capacity() - (tail - known_head_) < values.size())
      known_head_ = head_.load(std::memory_order_acquire);
    const std::size_t count = std::min(values.size(), capacity() - (tail - known_head_));
    for (std::size_t i = 0; i < count; ++i) slots_[(tail + i) & mask_] = values[i];
    tail_.store(tail + count, std::memory_order_release);
    return count;
  }
  // Moves `value` in; false, and `value` unchanged, if the queue is full.
  bool push(T&& value) {
    const std::size_t tail = tail_.load(std::memory_order_relaxed);
    if (tail - known_head_ == capacity()) {
      known_head_ = head_.load(std::memory_order_acquire);
      if (tail - known_head_ == capacity()) return false;
    }
    slots_[tail & mask_] = std::move(value);
    tail_.store(tail + 1, std::memory_order_release);
    return true;
  }
  bool push(const T& value) { return push(std::span(&value, 1)) == 1; }

  // Moves the oldest element out; false if there is none.
  bool pop(T& value) {
    const std::size_t head = head_.load(std::memory_order_relaxed);
    if (head == known_tail_) {
      known_tail_ = tail_.load(std::memory_order_acquire);
      if (head == known_tail_) return false;
    }
    value = std::move(slots_[head & mask_]);
    head_.store(head + 1, std::memory_order_release);
    return true;
  }

  // How many wait. The answer may be out of date already.
  std::size_t size() const {
    const std::size_t head = head_.load(std::memory_order_acquire);
    return std::min(tail_.load(std::memory_order_acquire) - head, capacity());
  }

  // How many were pushed, and how many of these popped, since the queue was made.
  std::size_t pushed() const { return tail_.load(std::memory_order_acquire); }
  std::size_t popped() const { return head_.load(std::memory_order_acquire); }

 private:
  static constexpr std::size_t kCacheLine = 64;
  const std::size_t mask_;
  const std::unique_ptr<T[]> slots_;
  // Indices never wrap; the slot is the index modulo the capacity.
  alignas(kCacheLine) std::atomic<std::size_t> tail_{0};
  std::size_t known_head_ = 0;  // the pusher's
  alignas(kCacheLine) std::atomic<std::size_t> head_{0};
  std::size_t known_tail_ = 0;  // the popper's
};

}  // namespace incise::input
