#include "server/core/cut/conforming/joining_stage.hpp"

#include <algorithm>
#include <cmath>

namespace incise::core {

using namespace tolerance;

namespace {

// Which way the blade moves, across itself: a unit vector, or 0 where it moves along itself, or hardly at all.
Vec3 direction_of(const BladeLine& from, const BladeLine& to) {
  const Vec3 motion = (to.heel - from.heel) + (to.tip - from.tip);
  const Vec3 along = normalized(to.tip - to.heel);
  const Vec3 across = motion - dot(motion, along) * along;
  if (squared_length(across) < kLeastAcross * kLeastAcross * squared_length(motion)) return {};
  return normalized(across);
}

}  // namespace

void JoiningStage::begin(const Batch& batch) {
  parts_.clear();
  next_ = 0;
  for (std::size_t i = 0; i + 1 < batch.lines.size(); ++i) {
    const BladeLine& from = batch.lines[i];
    const Vec3 direction = direction_of(from, batch.lines[i + 1]);
    const bool ends = squared_length(direction_) > 0, begins = squared_length(direction) > 0;
    if (ends && !begins) list(from, direction_);
    if (begins && !ends) list(from, -direction);
    direction_ = direction;
  }
  if (batch.ends_stroke && squared_length(direction_) > 0) list(batch.lines.back(), direction_);
}

bool JoiningStage::advance(WorkBudget& budget) {
  while (next_ < parts_.size()) {
    cut_.work.charge(budget);
    if (budget.spent()) return false;
    const Part& part = parts_[next_++];
    cut_.work += cost::kLook;
    const double ahead_m =
        std::max(wall_ahead(part.from, part.direction), wall_ahead(part.to, part.direction));
    if (ahead_m < 0) continue;
    const Vec3 by = (ahead_m + kJoinBeyond_h * cut_.h) * part.direction;
    cut_.path.add_strip(part.from, part.to, part.to + by, part.from + by);
  }
  return true;
}

// Lists the parts of a line at which the sweep ends, and would go on in that direction.
void JoiningStage::list(const BladeLine& line, const Vec3& direction) {
  const int count = static_cast<int>(
      std::clamp(std::ceil(distance(line.heel, line.tip) / (kJoinPart_h * cut_.h)), 1.0, kMaxJoinParts));
  const auto at = [&](int i) {
    return i == 0       ? line.heel
           : i == count ? line.tip
                        : lerp(line.heel, line.tip, static_cast<double>(i) / count);
  };
  const Vec3 reach{cut_.h, cut_.h, cut_.h};
  const Vec3 low = cut_.workspace.grid.low() - reach, high = cut_.workspace.grid.high() + reach;
  for (int i = 0; i < count; ++i) {
    const Vec3 a = at(i), b = at(i + 1);
    if (std::max(a.x, b.x) < low.x || std::max(a.y, b.y) < low.y || std::max(a.z, b.z) < low.z ||
        std::min(a.x, b.x) > high.x || std::min(a.y, b.y) > high.y || std::min(a.z, b.z) > high.z)
      continue;
    parts_.push_back({a, b, direction});
  }
}

// How far ahead of p an older cut is, or the body's own boundary where this faces a blade that moves in that direction: not where the
// blade enters the body. Below 0 where there is none within reach. The stroke's own faces open farther behind the blade.
double JoiningStage::wall_ahead(const Vec3& p, const Vec3& direction) const {
  const double reach = kJoinReach_h * cut_.h;
  const Vec3 r{reach, reach, reach};
  double ahead = -1;
  cut_.workspace.grid.visit_box(p - r, p + r, [&](TetId t) {
    if (!mesh_.alive(t)) return;
    const unsigned mask = mesh_.boundary_mask(t);
    cut_.work += cost::kLook;
    for (int f = 0; f < 4; ++f) {
      if (!(mask >> f & 1)) continue;
      const Vec3 n = mesh_.twice_area(half_face(t, f));
      if (!(mesh_.cut_mask(t) >> f & 1) && std::abs(dot(n, direction)) < kCosFacing * length(n)) continue;
      const auto v = mesh_.face_vertices(half_face(t, f));
      const Vec3 q = closest_point(p, mesh_.position(v[0]), mesh_.position(v[1]), mesh_.position(v[2]));
      if (squared_length(q - p) <= reach * reach) ahead = std::max(ahead, dot(q - p, direction));
    }
  });
  return ahead;
}

}  // namespace incise::core
