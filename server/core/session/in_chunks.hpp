#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "server/core/util/work_budget.hpp"

namespace incise::core {

// Elements between two looks at the budget.
inline constexpr std::size_t kChunk = 64;

// Calls work(i) for i from `next` on, until `end` (true; `next` is 0 again) or until the budget is spent (false). `quarters`: what
// an element costs, in quarters of a unit.
template <class Work>
bool in_chunks(std::size_t& next, std::size_t end, WorkBudget& budget, std::int64_t quarters, Work work) {
  while (next < end) {
    if (budget.spent()) return false;
    const std::size_t stop = std::min(next + kChunk, end);
    budget.charge(1 + quarters * static_cast<std::int64_t>(stop - next) / 4);
    for (; next < stop; ++next) work(next);
  }
  next = 0;
  return true;
}

}  // namespace incise::core
