#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "server/core/cut/line_anchor.hpp"
#include "server/core/stroke/blade.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// Where a sweep began or ended, and a strip of what was swept there, which goes with the tissue as it moves (SweptFollower).
struct SweepEnd {
  static constexpr std::size_t kMaxLines = 16;
  static constexpr std::uint32_t kMaxParts = 64;

  std::uint32_t stroke = 0;
  double travel_m = 0;  // of the blade in that stroke, then; infinity where it turned back
  std::array<BladeLine, kMaxLines>
      lines;  // the first one is where it ended, the others follow the sweep from there
  std::array<LineAnchor, kMaxLines> anchors{};
  std::uint32_t line_count = 0;
  double first_part = 0, last_part = 1;  // what of the blade, from heel to tip, was near the tissue
  std::uint32_t part_count = 0;          // into which that is divided, kMaxParts at most
  std::uint64_t taken = 0;               // bit k: a later sweep has taken up part k
  // Bit k of a part: amid it and at line k, the mesh has a face of a cut. Found out as later sweeps come near.
  std::array<std::uint16_t, kMaxParts> open{};
  Vec3 low, high;  // a box around all lines'

  void enclose();  // sets low and high
  // Where a part begins on the blade, from heel to tip.
  double along(double part) const { return first_part + (last_part - first_part) * part / part_count; }
  // A point of line k, at the beginning of a part.
  Vec3 at(std::size_t line, std::uint32_t part) const {
    return lerp(lines[line].heel, lines[line].tip, along(part));
  }
  // The farthest line to which the part goes straight from line k, to within the tolerance.
  std::uint32_t straight_to(std::uint32_t k, std::uint32_t part, double tolerance_m) const;
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
  // Calls visit(line, anchor) for all lines.
  template <class Visit>
  void each_line(Visit visit) const {
    for (const SweepEnd& end : ends_) {
      for (std::size_t k = 0; k < end.line_count; ++k) visit(end.lines[k], end.anchors[k]);
    }
  }
  // Forgets the ends for which is_lost(anchors) holds.
  template <class IsLost>
  void forget_if(IsLost is_lost) {
    std::erase_if(ends_, [&](const SweepEnd& end) { return is_lost(end.anchors); });
  }
  // Nothing has an anchor: the numbers of vertices are others.
  void lose_anchors() {
    for (SweepEnd& end : ends_) end.anchors = {};
  }

  void archive(Archive& io);

 private:
  static constexpr std::size_t kMaxEnds = 64;

  std::vector<SweepEnd> ends_;  // the oldest first
};

}  // namespace incise::core
