#include "server/core/cut/conforming/tissue_grid.hpp"

#include <algorithm>
#include <cmath>

namespace incise::core {

using namespace tolerance;

namespace {

// How far points are moved aside, of a step: far more than what is rounded.
constexpr double kAside = 1e-3;
// The square of how high a triangle is, of its longest edge: what is lower has no plane. And what is rounded in how far off a plane a point is.
constexpr double kLine = 1e-12, kRounded = 1e-6;

}  // namespace

Box TissueGrid::box_of(TetId t) const {
  const auto& v = mesh_.vertices(t);
  const auto at = [&](std::size_t k) { return mesh_.position(v[k]); };
  return Box::around({at(0), at(1), at(2), at(3)});
}

// The whole numbers from `low` to `high` that number points along an axis: first and last.
std::array<int, 2> TissueGrid::range(double low, double high, int axis) const {
  // By hand: std::ceil and std::floor are calls on processors that have no instruction for them.
  const double last = points_[static_cast<std::size_t>(axis)] - 1;
  low = std::clamp(low, 0.0, last + 1);
  high = std::clamp(high, -1.0, last);
  const int from = static_cast<int>(low), to = static_cast<int>(high);
  return {from + (from < low ? 1 : 0), to - (to > high ? 1 : 0)};
}

// Not from the box's corner: that lies as far from what parts the tissue there as is a whole number of steps, and a layer of points in the plane of a sweep
// would be on this side of some of its triangles and on that side of others, as they are rounded.
void TissueGrid::lay_out(const Box& box, double step_m) {
  const Vec3 aside = kAside * step_m * Vec3{1, 0.62, 0.38};
  box_ = {box.low - aside, box.high - aside};
  step_m_ = step_m;
  const Vec3 size = to_grid(box.high);
  std::size_t count = 1;
  first_ = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const auto a = static_cast<std::size_t>(axis);
    points_[a] = static_cast<int>(std::lround(coordinate(size, axis))) + 1;
    step_[a] = count;
    first_ += count;
    count *= static_cast<std::size_t>(points_[a]) + 2;
  }
  cut_.part_judging += count * cost::kPartNeckPoint;
  sides_.assign(count, 0);
  walls_.assign(count, 0);
  skin_.clear();
}

std::size_t TissueGrid::fill(TetId t, std::uint8_t side) {
  cut_.work += cost::kLook;
  std::size_t count = 0;
  each_point(t, [&](std::size_t at) {
    if (sides_[at] != 0) return;
    sides_[at] = side;
    ++count;
  });
  for (int f = 0; f < 4; ++f) {
    if (mesh_.opposite(half_face(t, f)) != kNone) continue;
    const auto v = mesh_.face_vertices(half_face(t, f));
    const Vec3 &a = mesh_.position(v[0]), &b = mesh_.position(v[1]), &c = mesh_.position(v[2]);
    const bool is_skin = !(mesh_.cut_mask(t) >> f & 1);
    block(a, b, c, is_skin ? kBlocked | kBlockedBySkin : kBlocked);
    if (is_skin) skin_.push_back(wall(a, b, c, Box::around({a, b, c}).widened(gap_m())));
  }
  return count;
}

void TissueGrid::block_swept() {
  near_.clear();
  std::size_t looked_at = 0;
  cut_.workspace.swept.any_in(box_.widened(gap_m()), looked_at, [&](const SweptMemory::Quad& quad) {
    near_.push_back({&quad, quad.box().widened(gap_m())});
    for (const auto& [a, b, c] : quad.triangles()) block(a, b, c);
    return false;
  });
  cut_.work.add(looked_at, cost::kQuadsAUnit);
  list_rims();
  for (std::size_t i = 0; i < rims_.size(); i += kRimBlock) {
    const std::span<const Rim> rims = std::span(rims_).subspan(i, std::min(kRimBlock, rims_.size() - i));
    Box around = rims[0].around();
    for (const Rim& rim : rims) around.add(rim.around());
    list_walls(around);
    for (const Rim& rim : rims) lead_on(rim);
  }
}

TissueGrid::Triangle TissueGrid::wall(const Vec3& a, const Vec3& b, const Vec3& c, const Box& around) {
  const Vec3 across = cross(b - a, c - a);
  const double edges_m2 = std::max({squared_length(b - a), squared_length(c - b), squared_length(a - c)});
  const bool is_line = squared_length(across) <= kLine * edges_m2 * edges_m2;
  const Vec3 normal = is_line ? Vec3{} : normalized(across);
  return {a, b, c, around, normal, dot(normal, a)};
}

// Lists the rims near the box of what was swept, and where sweeps begin and end.
void TissueGrid::list_rims() {
  rims_.clear();
  const auto is_near = [&](const Vec3& a, const Vec3& b) {
    return Box::around({a, b}).widened(gap_m()).meets(box_);
  };
  for (const auto& [quad, around] : near_) {
    const BladeLine &from = quad->from, &to = quad->to;
    const bool heel = is_near(from.heel, to.heel), tip = is_near(from.tip, to.tip);
    if (!quad->has_rims || (!heel && !tip)) continue;
    const Vec3 along = normalized((from.tip - from.heel) + (to.tip - to.heel));
    const Vec3 motion = (to.heel - from.heel) + (to.tip - from.tip);
    const Vec3 normal = normalized(cross(along, motion));
    if (heel) rims_.push_back({from.heel, to.heel, -along, normal, quad->stroke, quad->travel_m});
    if (tip) rims_.push_back({from.tip, to.tip, along, normal, quad->stroke, quad->travel_m});
  }
  SweepEnds& ends = cut_.workspace.ends;
  for (std::size_t i = 0; i < ends.size(); ++i) {
    const BladeLine &line = ends[i].lines[0], &before = ends[i].lines[1];
    if (!is_near(line.heel, line.tip)) continue;
    const Vec3 along = normalized(line.tip - line.heel);
    const Vec3 motion = (line.heel - before.heel) + (line.tip - before.tip);
    const Vec3 away = normalized(motion - dot(motion, along) * along);
    rims_.push_back({line.heel, line.tip, away, cross(along, away), ends[i].stroke, ends[i].travel_m});
  }
}

// Leads a rim on to what is near.
void TissueGrid::lead_on(const Rim& rim) {
  list_beside(rim);
  if (beside_.empty()) return;
  const int count = std::max(1, static_cast<int>(std::ceil(distance(rim.a, rim.b) / (kNeckRim_h * cut_.h))));
  const auto at = [&](double i) { return lerp(rim.a, rim.b, i / count); };
  const auto leads = [&](int i) {
    const Vec3 middle = at(i + 0.5);
    return Box{middle, middle}.widened(gap_m()).meets(box_) && is_near_beside(middle);
  };
  for (int i = 0; i < count; ++i) {
    if (!leads(i)) continue;
    const Vec3 p = at(i);
    do ++i;
    while (i < count && leads(i));
    const Vec3 q = at(i);
    for (const Vec3& direction : {rim.away, rim.normal, -rim.normal}) {
      const Vec3 by = gap_m() * direction;
      block(p, q, q + by);
      block(p, q + by, p + by);
    }
  }
}

// Lists what is near some rims: the skin, and sweeps.
void TissueGrid::list_walls(const Box& rims) {
  walls_beside_.clear();
  for (const Triangle& t : skin_) {
    if (t.around.meets(rims)) walls_beside_.push_back({t, nullptr});
  }
  for (const Swept& swept : near_) {
    if (!swept.around.meets(rims)) continue;
    for (const auto& [a, b, c] : swept.quad->triangles())
      walls_beside_.push_back({wall(a, b, c, swept.around), swept.quad});
  }
  cut_.work.add(skin_.size() + near_.size(), cost::kWallsAUnit);
}

// Of these, what one rim may be led on to: the skin, another sweep, or quite another part of this one.
void TissueGrid::list_beside(const Rim& rim) {
  beside_.clear();
  cut_.work.add(walls_beside_.size(), cost::kWallsAUnit);
  const Box around = rim.around();
  for (const Wall& wall : walls_beside_) {
    if (!wall.triangle.around.meets(around)) continue;
    const bool is_other = wall.quad == nullptr || wall.quad->stroke != rim.stroke ||
                          std::abs(wall.quad->travel_m - rim.travel_m) > kFar_h * cut_.h;
    if (is_other) beside_.push_back(wall.triangle);
  }
}

bool TissueGrid::is_near_beside(const Vec3& p) const {
  const double gap = gap_m();
  return std::ranges::any_of(beside_, [&](const Triangle& t) {
    return t.around.has(p) && std::abs(dot(t.normal, p) - t.offset) <= (1 + kRounded) * gap &&
           squared_length(closest_point(p, t.a, t.b, t.c) - p) <= gap * gap;
  });
}

// Blocks the ways between neighbouring points that a triangle crosses; also at its edges, so that none slips through between two that share one.
void TissueGrid::block(const Vec3& a, const Vec3& b, const Vec3& c, unsigned by) {
  constexpr double kEdge = 1e-9;
  // What was swept near the box lies beside it, most of it.
  if (!Box::around({a, b, c}).meets(box_)) return;
  const Vec3 p[3] = {to_grid(a), to_grid(b), to_grid(c)};
  for (int axis = 0; axis < 3; ++axis) {
    const int u = (axis + 1) % 3, w = (axis + 2) % 3;
    double pu[3], pw[3];
    for (int i = 0; i < 3; ++i) {
      pu[i] = coordinate(p[i], u);
      pw[i] = coordinate(p[i], w);
    }
    const auto us =
        range(std::min({pu[0], pu[1], pu[2]}) - kEdge, std::max({pu[0], pu[1], pu[2]}) + kEdge, u);
    const auto ws =
        range(std::min({pw[0], pw[1], pw[2]}) - kEdge, std::max({pw[0], pw[1], pw[2]}) + kEdge, w);
    // Many are so small that no way is near.
    if (us[0] > us[1] || ws[0] > ws[1]) continue;
    const double area = (pu[1] - pu[0]) * (pw[2] - pw[0]) - (pw[1] - pw[0]) * (pu[2] - pu[0]);
    if (std::abs(area) < kEdge) continue;
    const std::size_t step = step_[static_cast<std::size_t>(axis)];
    const std::size_t along = step_[static_cast<std::size_t>(u)], across = step_[static_cast<std::size_t>(w)];
    const double farthest = points_[static_cast<std::size_t>(axis)] - 1;
    // A corner's weight at (x, y) of the plane across the axis is linear there, and so is where the triangle is along the axis. It covers what no weight
    // is negative at: of a row, what lies between where they are 0.
    Linear along_axis;
    GridRows rows;
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3, k = (i + 2) % 3;
      const Linear weight =
          Linear{pu[j] * pw[k] - pu[k] * pw[j], pw[j] - pw[k], pu[k] - pu[j]}.times(1 / area);
      const double at = coordinate(p[i], axis);
      along_axis = {along_axis.first + at * weight.first, along_axis.by_j + at * weight.by_j,
                    along_axis.by_k + at * weight.by_k};
      rows.add(weight.by_j, {-kEdge - weight.first, 0, -weight.by_k}, 1);
    }
    for (int y = ws[0]; y <= ws[1]; ++y) {
      rows.each_inside(0, y, us[0], us[1], [&](int x) {
        const double at = along_axis.at(x, y);
        if (at < 0 || at >= farthest) return;
        walls_[first_ + static_cast<std::size_t>(at) * step + static_cast<std::size_t>(x) * along +
               static_cast<std::size_t>(y) * across] |= static_cast<std::uint8_t>(by << axis);
      });
    }
    cut_.work.add(static_cast<std::size_t>(ws[1] - ws[0]) + 1, cost::kRowsAUnit);
  }
}

}  // namespace incise::core
