#pragma once

#include <cstddef>
#include <vector>

namespace incise::core {

// Memory that is not touched costs only address space, except in builds with a sanitizer, which touches its
// shadow for each new session. With little room it also finds stale pointers into arrays that have moved.
#if INCISE_SMALL_ROOM
inline constexpr std::size_t kSpareRoom = std::size_t{64} << 10;
#else
inline constexpr std::size_t kSpareRoom = std::size_t{4} << 20;
#endif

// The capacity of an array that begins with `count` elements and grows with the work done: enough for hours of cutting,
// since moving a large array to a larger place takes milliseconds, in the middle of a frame.
inline constexpr std::size_t room_for(std::size_t count) {
  return count + count / 4 + kSpareRoom;
}

// A copy with room to grow. O(values).
template <class T>
std::vector<T> copy_with_room(const std::vector<T>& values) {
  std::vector<T> copy;
  copy.reserve(room_for(values.size()));
  copy.assign(values.begin(), values.end());
  return copy;
}

// An array of `count` elements with room to grow, as a fresh session has it.
template <class T>
void grow_to(std::vector<T>& values, std::size_t count) {
  values.reserve(room_for(count));
  values.resize(count, T{});
}

}  // namespace incise::core
