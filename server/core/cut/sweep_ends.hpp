#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "server/core/stroke/blade.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// Where a sweep began or ended, and a strip of what was swept there.
struct SweepEnd {
  static constexpr std::size_t kMaxLines = 16;

  std::uint32_t stroke = 0;
  double travel_m = 0;  // of the blade in that stroke, then
  std::array<BladeLine, kMaxLines>
      lines;  // the first one is where it ended, the others follow the sweep from there
  std::uint32_t line_count = 0;
  double first_part = 0, last_part = 1;  // what of the blade, from heel to tip, was near the tissue
  std::uint32_t part_count = 0;          // into which that is divided, kMaxParts at most
  std::uint64_t taken = 0;               // bit k: a later sweep has taken up part k
  Vec3 low, high;                        // a box around all lines'

  // A point of line k, at the beginning of a part.
  Vec3 at(std::size_t line, std::uint32_t part) const {
    const double u = first_part + (last_part - first_part) * part / part_count;
    return lerp(lines[line].heel, lines[line].tip, u);
  }
};

// The newest ends of what all blades have swept in a body: enough for a part that is cut out by dozens of strokes. Between
// an end and the next vertices of the mesh, tissue may hold together that a later sweep, once it meets the end, has to part.
class SweepEnds {
 public:
  SweepEnds() { ends_.reserve(kMaxEnds); }

  std::size_t size() const { return ends_.size(); }
  SweepEnd& operator[](std::size_t i) { return ends_[i]; }
  // Adds the end of a sweep: `lines`, two at least, from there back. What lies outside of the box, the tissue's, is left out;
  // parts are `part_m` long, or longer where there are too many.
  void add(std::uint32_t stroke, double travel_m, const BladeLine* lines, std::size_t count, double part_m,
           const Vec3& low, const Vec3& high);
  // The body has moved, the ends have not.
  void clear() { ends_.clear(); }

  void archive(Archive& io);

 private:
  static constexpr std::size_t kMaxEnds = 64;
  static constexpr std::uint32_t kMaxParts = 64;

  std::vector<SweepEnd> ends_;  // the oldest first
};

}  // namespace incise::core
