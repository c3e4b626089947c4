#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "server/core/util/room.hpp"

namespace incise::core {

// Marks on the elements of an array that need no clearing: each question takes numbers that no element bears yet.
class FreshMarks {
 public:
  void grow_to(std::size_t count) { core::grow_to(marks_, count); }
  void push_back() { marks_.push_back(0); }

  // The first of `count` fresh numbers that follow each other. After 2^32 of them, some hours of cutting, all marks are wiped.
  std::uint32_t fresh(std::uint32_t count = 1) {
    if (last_ > UINT32_MAX - count) {
      std::fill(marks_.begin(), marks_.end(), 0u);
      last_ = 0;
    }
    last_ += count;
    return last_ - count + 1;
  }
  std::uint32_t& operator[](std::size_t i) { return marks_[i]; }
  std::uint32_t* data() { return marks_.data(); }

 private:
  std::uint32_t last_ = 0;
  std::vector<std::uint32_t> marks_;
};

}  // namespace incise::core
