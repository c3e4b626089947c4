#pragma once

#include <cstddef>
#include <vector>

#include "server/base/large_pages.hpp"

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

// Gives an empty array that room. `count`: elements that it will begin with.
template <class T>
void reserve_room(std::vector<T>& values, std::size_t count) {
  values.reserve(room_for(count));
  prefer_large_pages(values.data(), count * sizeof(T));
}

// A copy with room to grow. O(values).
template <class T>
std::vector<T> copy_with_room(const std::vector<T>& values) {
  std::vector<T> copy;
  reserve_room(copy, values.size());
  copy.assign(values.begin(), values.end());
  return copy;
}

// Lengthens an array to `count` elements and gives it room to grow, as a fresh session has it. O(count).
template <class T>
void grow_to(std::vector<T>& values, std::size_t count) {
  std::vector<T> roomy;
  reserve_room(roomy, count);
  roomy.assign(values.begin(), values.end());
  roomy.resize(count, T{});
  values.swap(roomy);
}

}  // namespace incise::core
