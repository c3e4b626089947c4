#pragma once

#include <cstddef>

namespace incise::core {

// The capacity of an array that begins with `count` elements and grows with the work done: enough for hours of cutting,
// since moving a large array to a larger place takes milliseconds, in the middle of a frame. Memory that is not touched
// costs nothing but address space.
inline constexpr std::size_t room_for(std::size_t count) {
  return count + count / 4 + (std::size_t{4} << 20);
}

}  // namespace incise::core
