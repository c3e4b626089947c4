#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "server/core/util/work_budget.hpp"

namespace incise::core {

// Elements between two looks at the budget.
inline constexpr std::size_t kChunk = 64;

// Calls work(first, stop) for chunks from `next` on, until `end` (true; `next` is 0 again) or until the budget is spent (false).
// `quarters`: what an element costs, in quarters of a unit.
template <class Work>
bool chunk_by_chunk(std::size_t& next, std::size_t end, WorkBudget& budget, std::int64_t quarters,
                    Work work) {
  while (next < end) {
    if (budget.spent()) return false;
    const std::size_t first = next;
    next = std::min(first + kChunk, end);
    budget.charge(1 + quarters * static_cast<std::int64_t>(next - first) / 4);
    work(first, next);
  }
  next = 0;
  return true;
}

// The same, calling work(i) for each element.
template <class Work>
bool in_chunks(std::size_t& next, std::size_t end, WorkBudget& budget, std::int64_t quarters, Work work) {
  return chunk_by_chunk(next, end, budget, quarters, [&work](std::size_t first, std::size_t stop) {
    for (std::size_t i = first; i < stop; ++i) work(i);
  });
}

}  // namespace incise::core
