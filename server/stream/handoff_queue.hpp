#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <utility>

namespace incise::stream {

// An unbounded queue from one thread to one other: push() never waits, never fails and takes no lock. Elements lie in
// linked blocks; one consumed block is kept for reuse, so a queue that is drained in time allocates nothing.
//
// Thread: push() from one thread, pop() from one thread.
template <class T, std::size_t kBlock = 256>
class HandoffQueue {
 public:
  HandoffQueue() : first_(new Block), last_(first_) {}
  ~HandoffQueue() {
    while (first_) delete std::exchange(first_, first_->next.load(std::memory_order_relaxed));
    delete spare_.load(std::memory_order_relaxed);
  }
  HandoffQueue(const HandoffQueue&) = delete;
  HandoffQueue& operator=(const HandoffQueue&) = delete;

  void push(T value) {
    if (last_filled_ == kBlock) {
      Block* block = spare_.exchange(nullptr, std::memory_order_acquire);
      if (!block) block = new Block;
      last_->next.store(block, std::memory_order_release);
      last_ = block;
      last_filled_ = 0;
    }
    last_->values[last_filled_] = std::move(value);
    last_->filled.store(++last_filled_, std::memory_order_release);
    pushed_.store(pushed_.load(std::memory_order_relaxed) + 1, std::memory_order_release);
  }

  // Moves the oldest element out. False where the queue is empty.
  bool pop(T& value) {
    if (taken_ == kBlock) {
      Block* next = first_->next.load(std::memory_order_acquire);
      if (!next) return false;
      Block* done = std::exchange(first_, next);
      taken_ = 0;
      done->next.store(nullptr, std::memory_order_relaxed);
      done->filled.store(0, std::memory_order_relaxed);
      delete spare_.exchange(done, std::memory_order_acq_rel);
    }
    if (taken_ == first_->filled.load(std::memory_order_acquire)) return false;
    value = std::exchange(first_->values[taken_++], T{});
    popped_.store(popped_.load(std::memory_order_relaxed) + 1, std::memory_order_release);
    return true;
  }

  // How many wait; may be out of date on return. From any thread.
  std::size_t size() const {
    const std::size_t popped = popped_.load(std::memory_order_acquire);
    return pushed_.load(std::memory_order_acquire) - popped;
  }

 private:
  struct Block {
    std::array<T, kBlock> values{};
    std::atomic<std::size_t> filled{0};
    std::atomic<Block*> next{nullptr};
  };
  static constexpr std::size_t kCacheLine = 64;
  // The consumer's.
  alignas(kCacheLine) Block* first_;
  std::size_t taken_ = 0;
  std::atomic<std::size_t> popped_{0};
  // The producer's.
  alignas(kCacheLine) Block* last_;
  std::size_t last_filled_ = 0;
  std::atomic<std::size_t> pushed_{0};
  alignas(kCacheLine) std::atomic<Block*> spare_{nullptr};
};

}  // namespace incise::stream
