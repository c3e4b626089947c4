#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace incise::core {

// A set of ids that is filled, then emptied in ascending order: sorting without comparisons that can be interrupted at
// any time. Two levels of bits. Keeps its memory.
class IdSet {
 public:
  // Room for ids below `slots`.
  void grow(std::size_t slots) {
    const std::size_t words = (slots + 63) / 64;
    if (words > words_.size()) {
      words_.resize(words, 0);
      summary_.resize((words + 63) / 64, 0);
    }
  }
  bool empty() const { return size_ == 0; }
  // Returns whether the id is new. Not allowed between the first take() and the last. O(1).
  bool insert(std::uint32_t id) {
    std::uint64_t& word = words_[id / 64];
    const std::uint64_t bit = std::uint64_t{1} << id % 64;
    if (word & bit) return false;
    word |= bit;
    summary_[id / 4096] |= std::uint64_t{1} << id / 64 % 64;
    ++size_;
    return true;
  }
  // Removes and returns the least id; the set must not be empty. O(1), and O(slots / 4096) for all of them.
  std::uint32_t take() {
    while (summary_[first_] == 0) ++first_;
    const std::size_t at = 64 * first_ + static_cast<std::size_t>(std::countr_zero(summary_[first_]));
    std::uint64_t& word = words_[at];
    const auto id = static_cast<std::uint32_t>(64 * at) + static_cast<std::uint32_t>(std::countr_zero(word));
    word &= word - 1;
    if (word == 0) summary_[first_] &= summary_[first_] - 1;
    if (--size_ == 0) first_ = 0;
    return id;
  }

 private:
  std::vector<std::uint64_t> words_, summary_;  // bit i of the summary: words_[i] is not 0
  std::size_t size_ = 0, first_ = 0;            // no bit before summary_[first_] is set while ids are taken
};

}  // namespace incise::core
