#include "server/core/cut/sweep_ends.hpp"

#include <algorithm>
#include <cmath>

#include "server/core/geometry/clip.hpp"
#include "server/core/stroke/swept_triangle.hpp"

namespace incise::core {
std::uint32_t SweepEnd::straight_to(std::uint32_t k, std::uint32_t part, double tolerance_m) const {
  const auto is_straight = [&](std::uint32_t to) {
    for (std::uint32_t side : {part, part + 1}) {
      const Vec3 a = at(k, side), b = at(to, side);
      for (std::uint32_t i = k + 1; i < to; ++i) {
        if (squared_distance_to_segment(at(i, side), a, b) > tolerance_m * tolerance_m) return false;
      }
    }
    return true;
  };
  std::uint32_t farthest = k + 1;
  while (farthest + 1 < line_count && is_straight(farthest + 1)) ++farthest;
  return farthest;
}

void SweepEnd::enclose() {
  low = high = at(0, 0);
  for (std::size_t k = 0; k < line_count; ++k) {
    extend(at(k, 0), low, high);
    extend(at(k, part_count), low, high);
  }
}

void SweepEnds::add(std::uint32_t stroke, double travel_m, const BladeLine* lines, std::size_t count,
                    double part_m, const Vec3& low, const Vec3& high) {
  SweepEnd end;
  if (!clip(lines[0].heel, lines[0].tip, {low, high}, end.first_part, end.last_part)) return;
  end.stroke = stroke;
  end.travel_m = travel_m;
  end.line_count = static_cast<std::uint32_t>(std::min(count, SweepEnd::kMaxLines));
  std::copy_n(lines, end.line_count, end.lines.begin());
  const double length_m = (end.last_part - end.first_part) * distance(lines[0].heel, lines[0].tip);
  end.part_count =
      static_cast<std::uint32_t>(std::clamp(std::ceil(length_m / part_m), 1.0, 1.0 * SweepEnd::kMaxParts));
  end.enclose();
  if (ends_.size() == kMaxEnds) ends_.erase(ends_.begin());
  ends_.push_back(end);
}

void SweepEnds::archive(Archive& io) {
  io.list(ends_, 61, [&](SweepEnd& end) {
    io(end.stroke);
    io(end.travel_m);
    io(end.line_count);
    io.demand(end.line_count >= 2 && end.line_count <= SweepEnd::kMaxLines,
              "the end of a sweep has too few or too many lines");
    if (io.failed()) return;
    for (std::size_t i = 0; i < end.line_count; ++i) {
      io(end.lines[i].heel);
      io(end.lines[i].tip);
    }
    archive_anchors(io, end.anchors);
    io(end.first_part);
    io(end.last_part);
    io(end.part_count);
    io(end.taken);
    io(end.low);
    io(end.high);
    io.demand(end.part_count >= 1 && end.part_count <= SweepEnd::kMaxParts && end.first_part >= 0 &&
                  end.last_part <= 1,
              "the end of a sweep has no parts");
    if (io.failed()) return;
    for (std::uint32_t i = 0; i < end.part_count; ++i) io(end.open[i]);
  });
  io.demand(ends_.size() <= kMaxEnds, "more ends of sweeps than are kept");
  if (io.reads()) ends_.reserve(kMaxEnds);
}

}  // namespace incise::core
