#pragma once

#include <cstdint>

namespace incise::haptics {

// What one frame of one blade has looked at, and where it stops: a bound that no body and no motion exceeds. What lies
// beyond is passed over (`cut_short`), which a body that is not made to be hostile does not come near: a blade across
// 1.5 million tetrahedra meets some 500 of them.
struct ProbeWork {
  static constexpr std::uint32_t kMostBoxes = 4096, kMostTriangles = 2048, kMostTets = 2048;

  std::uint32_t boxes = 0;      // of the surface's tree
  std::uint32_t triangles = 0;  // of the surface
  std::uint32_t tets = 0;       // walked through
  bool cut_short = false;

  // Each says whether there is room for one more.
  bool box() noexcept { return one(boxes, kMostBoxes); }
  bool triangle() noexcept { return one(triangles, kMostTriangles); }

 private:
  bool one(std::uint32_t& count, std::uint32_t most) noexcept {
    if (count == most) {
      cut_short = true;
      return false;
    }
    ++count;
    return true;
  }
};

}  // namespace incise::haptics
