#pragma once

#include <algorithm>

#include "server/core/geometry/box.hpp"

namespace incise::core {

// What of the segment a b lies in a box, as a range of its length; false where nothing does.
inline bool clip(const Vec3& a, const Vec3& b, const Box& box, double& first, double& last) {
  first = 0;
  last = 1;
  const auto clip_axis = [&](double from, double to, double least, double most) {
    const double way = to - from;
    if (way == 0) return from >= least && from <= most;
    const double s = (least - from) / way, t = (most - from) / way;
    first = std::max(first, std::min(s, t));
    last = std::min(last, std::max(s, t));
    return first < last;
  };
  return clip_axis(a.x, b.x, box.low.x, box.high.x) && clip_axis(a.y, b.y, box.low.y, box.high.y) &&
         clip_axis(a.z, b.z, box.low.z, box.high.z);
}

}  // namespace incise::core
