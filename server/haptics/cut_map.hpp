#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <vector>

#include "server/core/geometry/vec3.hpp"

namespace incise::haptics {

// Where a body has been cut, and in which directions: a grid of cells of 0.25 h, each with one bit
// for each of 16 directions; a cut sets the one nearest to its normal. So a frame's queries cost the same in a
// fresh body and in one that was cut to slices. At most 16 million cells, wider ones in larger bodies; two bytes for each, but
// only pages that a cut has come to take memory.
//
// Thread: one, at a time.
class CutMap {
 public:
  // A set of directions.
  using Directions = std::uint16_t;

  CutMap(const core::Vec3& low, const core::Vec3& high, double h);

  // Marks what a cut face covers, and 0.1 h on both sides. O(cells that it covers), at most some 6,000.
  void mark(const core::Vec3& a, const core::Vec3& b, const core::Vec3& c) noexcept;
  // O(what was marked).
  void clear() noexcept;
  bool empty() const { return !any_; }

  // The directions of cuts at p.
  Directions at(const core::Vec3& p) const noexcept;
  // The directions of cuts in which an edge along this unit vector lies, instead of crossing them: its angle to the cut is
  // below 40 degrees, within the 21 degrees that one direction covers.
  static Directions along(const core::Vec3& edge) noexcept;
  // m.
  double cell() const { return cell_; }

 private:
  std::size_t index(
      const core::Vec3& p) const noexcept;  // of its cell; beyond the last one where p is outside

  core::Vec3 origin_;
  double cell_ = 1, inverse_ = 1, aside_ = 0;
  std::int64_t count_[3] = {0, 0, 0};
  // Zeros that take no memory before one of their page is marked.
  struct Free {
    void operator()(Directions* cells) const { std::free(cells); }
  };
  std::unique_ptr<Directions[], Free> cells_;
  std::size_t cell_count_ = 0;
  // Stretches of kStretch cells that have been marked: clear() passes over the others.
  static constexpr std::size_t kStretch = 4096;
  std::vector<std::uint8_t> marked_;
  bool any_ = false;
};

}  // namespace incise::haptics
