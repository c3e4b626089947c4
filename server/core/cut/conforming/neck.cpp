#include "server/core/cut/conforming/neck.hpp"

#include <algorithm>
#include <cmath>

namespace incise::core {

using namespace tolerance;

namespace {

// How far points are moved aside, of a step: far more than what is rounded.
constexpr double kAside = 1e-3;

// A value that is linear in two numbers.
struct Linear {
  double first = 0, by_j = 0, by_k = 0;
  double at(double j, double k) const { return first + by_j * j + by_k * k; }
  Linear times(double factor) const { return {factor * first, factor * by_j, factor * by_k}; }
};

// The points of rows along an axis that are inside some planes.
class Rows {
 public:
  // Inside is where `along` times the place in row (j, k) is `rest` at least. `scale`: of what `along` is a part of; next to nothing of it says nothing
  // about the place.
  void add(double along, const Linear& rest, double scale) {
    if (std::abs(along) <= kAlongRow * scale) {
      beside_[besides_++] = rest;
    } else {
      (along > 0 ? in_[ins_++] : out_[outs_++]) = rest.times(1 / along);
    }
  }
  // Calls visit(i) for the points of row (j, k) from first to last, which are not negative, that are inside.
  template <class Visit>
  void each_inside(double j, double k, double first, double last, Visit visit) const {
    for (std::size_t i = 0; i < ins_; ++i) first = std::max(first, in_[i].at(j, k));
    for (std::size_t i = 0; i < outs_; ++i) last = std::min(last, out_[i].at(j, k));
    for (std::size_t i = 0; i < besides_; ++i) last = beside_[i].at(j, k) > 0 ? -1 : last;
    if (first > last) return;
    const int begin = static_cast<int>(first), end = static_cast<int>(last);
    for (int i = begin + (begin < first ? 1 : 0); i <= end; ++i) visit(i);
  }

 private:
  static constexpr double kAlongRow = 1e-12;

  std::array<Linear, 4> in_, out_, beside_;  // where a row comes in and goes out, and what rows it passes by
  std::size_t ins_ = 0, outs_ = 0, besides_ = 0;
};

}  // namespace

// Looks farther where one of the sides has little of itself near the face: how it lies beside a surface says little about it then. And where most of
// it is parted, but not all: faces of large elements lie beside what was swept, and put tissue near them on the wrong side.
Neck::Answer Neck::judge(HalfFace h) {
  const Vec3 middle = mesh_.face_middle(h);
  double face_m = 0;
  for (VertexId v : mesh_.face_vertices(h)) face_m = std::max(face_m, distance(mesh_.position(v), middle));
  Answer answer = Answer::kUnknown;
  for (double reach_h : kNeckReach_h) {
    const double reach_m = reach_h * cut_.h;
    if (face_m > reach_m) continue;
    lay_out(Box{middle, middle}.widened(reach_m), 2 * reach_m / (kNeckPoints - 1));
    const TetId other = tet_of(mesh_.opposite(h));
    pass_.begin();
    pass_.add(other);
    Counts counts{fill(tet_of(h), 1), fill(other, 2)};
    counts[2] = fill_between();
    block_swept();
    const double share = shared(counts);
    const bool together = share >= kNeckShared;
    answer = together ? Answer::kTogether : Answer::kApart;
    const double least_h3 =
        static_cast<double>(std::min(counts[0], counts[1])) * std::pow(step_m_ / cut_.h, 3);
    const bool sees_enough = reach_h > kNeckReach_h[0] || least_h3 >= kNeckPart_h3;
    if (share >= kNeckSure || (sees_enough && (!together || share >= kNeckDoubtful))) break;
  }
  return answer;
}

// What is thinner than two steps is left out: it is no neck, and whether points lie in it is chance. Looks farther where next to nothing of what is beside
// the part is near.
Neck::Answer Neck::judge(HalfFace h, std::span<const TetId> part) {
  Box box = box_of(part[0]);
  for (TetId t : part) box.add(box_of(t));
  Answer answer = Answer::kUnknown;
  for (double around_h : kPartAround_h) {
    if (!lay_out_finely(box.widened(around_h * cut_.h))) break;
    pass_.begin();
    for (TetId t : part) pass_.add(t);
    Counts counts{fill(tet_of(h), 1), fill(part, 2)};
    counts[2] = fill_between();
    block_swept();
    leave_out_thin(counts);
    const double beside_h3 = static_cast<double>(counts[0]) * std::pow(kPartStep_h, 3);
    if (counts[1] == 0 || beside_h3 < kPartBeside_h3) continue;
    const double share = shared(counts);
    answer = share >= kPartShared ? Answer::kTogether
             : share < kPartApart ? Answer::kApart
                                  : Answer::kUnknown;
    if (beside_h3 >= kNeckPart_h3) break;
  }
  return answer;
}

Box Neck::box_of(TetId t) const {
  const auto& v = mesh_.vertices(t);
  const auto at = [&](std::size_t k) { return mesh_.position(v[k]); };
  return Box::around({at(0), at(1), at(2), at(3)});
}

// The whole numbers from `low` to `high` that number points along an axis: first and last.
std::array<int, 2> Neck::range(double low, double high, int axis) const {
  // By hand: std::ceil and std::floor are calls on processors that have no instruction for them.
  const double last = points_[static_cast<std::size_t>(axis)] - 1;
  low = std::clamp(low, 0.0, last + 1);
  high = std::clamp(high, -1.0, last);
  const int from = static_cast<int>(low), to = static_cast<int>(high);
  return {from + (from < low ? 1 : 0), to - (to > high ? 1 : 0)};
}

bool Neck::lay_out_finely(const Box& box) {
  const double step_m = kPartStep_h * cut_.h;
  const Vec3 size = (1 / step_m) * (box.high - box.low);
  if ((size.x + 1) * (size.y + 1) * (size.z + 1) > kMaxPartPoints) return false;
  lay_out(box, step_m);
  return true;
}

// Not from the box's corner: that lies as far from what parts the tissue there as is a whole number of steps, and a layer of points in the plane of a sweep
// would be on this side of some of its triangles and on that side of others, as they are rounded.
void Neck::lay_out(const Box& box, double step_m) {
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
  cut_.work.add(count, cost::kNeckPointsAUnit);
  cut_.part_judging += count * cost::kPartNeckPoint;
  sides_.assign(count, 0);
  walls_.assign(count, 0);
  skin_.clear();
  filled_.clear();
}

// Marks the points in what hangs together with a tetrahedron in the box, and blocks the ways through the boundary there. Returns how many there
// are.
std::size_t Neck::fill(TetId from, std::uint8_t side) {
  tets_.assign(1, from);
  pass_.add(from);
  for (std::size_t i = 0; i < tets_.size(); ++i) take_beyond(tets_[i], false);
  return fill(tets_, side);
}

std::size_t Neck::fill(std::span<const TetId> tets, std::uint8_t side) {
  std::size_t count = 0;
  filled_.insert(filled_.end(), tets.begin(), tets.end());
  for (TetId t : tets) {
    cut_.work += cost::kLook;
    count += fill_tet(t, side);
    for (int f = 0; f < 4; ++f) {
      if (mesh_.opposite(half_face(t, f)) != kNone) continue;
      const auto v = mesh_.face_vertices(half_face(t, f));
      const Vec3 &a = mesh_.position(v[0]), &b = mesh_.position(v[1]), &c = mesh_.position(v[2]);
      block(a, b, c);
      if (!(mesh_.cut_mask(t) >> f & 1)) skin_.push_back({a, b, c, Box::around({a, b, c}).widened(gap_m())});
    }
  }
  return count;
}

// What hangs together with the two sides through faces that are about to open: a way may lead through it.
std::size_t Neck::fill_between() {
  tets_.clear();
  for (TetId t : filled_) take_beyond(t, true);
  for (std::size_t i = 0; i < tets_.size(); ++i) take_beyond(tets_[i], true);
  return fill(tets_, 3);
}

// Adds the neighbours of t that are in the box and in no list yet; `through`: those beyond a face that is about to open, too.
void Neck::take_beyond(TetId t, bool through) {
  for (int f = 0; f < 4; ++f) {
    const HalfFace o = mesh_.opposite(half_face(t, f));
    if (o == kNone || (!through && cut_.is_pending(o)) || pass_.has(tet_of(o))) continue;
    if (!box_of(tet_of(o)).meets(box_)) continue;
    pass_.add(tet_of(o));
    tets_.push_back(tet_of(o));
  }
}

std::size_t Neck::fill_tet(TetId t, std::uint8_t side) {
  Vec3 p[4];
  const auto& v = mesh_.vertices(t);
  for (int i = 0; i < 4; ++i) p[i] = to_grid(mesh_.position(v[i]));
  Vec3 low = p[0], high = p[0];
  for (int i = 1; i < 4; ++i) extend(p[i], low, high);
  // Of the small ones beside cuts many have no point.
  const auto across = range(low.x, high.x, 0), js = range(low.y, high.y, 1), ks = range(low.z, high.z, 2);
  if (across[0] > across[1] || js[0] > js[1] || ks[0] > ks[1]) return 0;
  Rows rows;
  for (int f = 0; f < 4; ++f) {
    const Vec3& a = p[(f + 1) % 4];
    Vec3 inward = cross(p[(f + 2) % 4] - a, p[(f + 3) % 4] - a);
    if (dot(inward, p[f] - a) < 0) inward = -inward;
    rows.add(inward.x, {dot(inward, a), -inward.y, -inward.z}, std::abs(inward.y) + std::abs(inward.z));
  }
  std::size_t count = 0;
  for (int k = ks[0]; k <= ks[1]; ++k) {
    for (int j = js[0]; j <= js[1]; ++j) {
      std::uint8_t* row = sides_.data() + point(0, j, k);
      rows.each_inside(j, k, across[0], across[1], [&](int i) {
        if (row[i] != 0) return;
        row[i] = side;
        ++count;
      });
    }
  }
  return count;
}

// Blocks the ways through what was swept, and those through gaps to the skin or another sweep that are no wider than what is one.
void Neck::block_swept() {
  near_.clear();
  for (const SweptMemory::Quad& quad : cut_.workspace.swept.quads()) {
    const Box around = quad.box().widened(gap_m());
    if (!around.meets(box_)) continue;
    near_.push_back({&quad, around});
    for (const auto& [a, b, c] : quad.triangles()) block(a, b, c);
  }
  cut_.work.add(cut_.workspace.swept.quads().size(), cost::kQuadsAUnit);
  for (std::size_t i = 0; i < near_.size(); ++i) {
    if (i % kRimBlock == 0) {
      Box around = near_[i].around;
      for (std::size_t j = i + 1; j < std::min(i + kRimBlock, near_.size()); ++j) around.add(near_[j].around);
      list_walls(around);
    }
    const SweptMemory::Quad& quad = *near_[i].quad;
    if (!quad.has_rims) continue;
    const BladeLine &from = quad.from, &to = quad.to;
    const Vec3 along = normalized((from.tip - from.heel) + (to.tip - to.heel));
    const Vec3 motion = (to.heel - from.heel) + (to.tip - from.tip);
    const Vec3 normal = normalized(cross(along, motion));
    lead_on(from.heel, to.heel, -along, normal, quad);
    lead_on(from.tip, to.tip, along, normal, quad);
  }
  SweepEnds& ends = cut_.workspace.ends;
  for (std::size_t i = 0; i < ends.size(); ++i) {
    const BladeLine &line = ends[i].lines[0], &before = ends[i].lines[1];
    const Vec3 along = normalized(line.tip - line.heel);
    const Vec3 motion = (line.heel - before.heel) + (line.tip - before.tip);
    const Vec3 away = normalized(motion - dot(motion, along) * along);
    list_walls(Box::around({line.heel, line.tip}));
    lead_on(line.heel, line.tip, away, cross(along, away),
            {line, line, ends[i].stroke, ends[i].travel_m, true});
  }
}

// Leaves out the points that lie between two blocked ways of an axis.
void Neck::leave_out_thin(Counts& counts) {
  for (std::size_t at = 0; at < sides_.size(); ++at) {
    if (sides_[at] == 0) continue;
    unsigned thin = 0;
    for (std::size_t axis = 0; axis < 3; ++axis) thin |= walls_[at] & walls_[at - step_[axis]] & 1u << axis;
    if (thin == 0) continue;
    --counts[sides_[at] - 1u];
    sides_[at] = 0;
  }
}

// Leads a rim from a to b on to what is near.
void Neck::lead_on(const Vec3& a, const Vec3& b, const Vec3& away, const Vec3& normal,
                   const SweptMemory::Quad& sweep) {
  const Box rim = Box::around({a, b});
  if (!rim.widened(gap_m()).meets(box_)) return;
  list_beside(rim, sweep);
  if (beside_.empty()) return;
  const int count = std::max(1, static_cast<int>(std::ceil(distance(a, b) / (kNeckRim_h * cut_.h))));
  for (int i = 0; i < count; ++i) {
    const Vec3 p = lerp(a, b, static_cast<double>(i) / count),
               q = lerp(a, b, static_cast<double>(i + 1) / count);
    const Vec3 middle = lerp(p, q, 0.5);
    if (!Box{middle, middle}.widened(gap_m()).meets(box_) || !is_near_beside(middle)) continue;
    for (const Vec3& direction : {away, normal, -normal}) {
      const Vec3 by = gap_m() * direction;
      block(p, q, q + by);
      block(p, q + by, p + by);
    }
  }
}

// Lists what is near some rims: the skin, and sweeps.
void Neck::list_walls(const Box& rims) {
  walls_beside_.clear();
  for (const Triangle& t : skin_) {
    if (t.around.meets(rims)) walls_beside_.push_back({t, nullptr});
  }
  for (const Swept& swept : near_) {
    if (!swept.around.meets(rims)) continue;
    for (const auto& [a, b, c] : swept.quad->triangles())
      walls_beside_.push_back({{a, b, c, swept.around}, swept.quad});
  }
  cut_.work.add(skin_.size() + near_.size(), cost::kWallsAUnit);
}

// Of these, what one rim may be led on to: the skin, another sweep, or quite another part of this one.
void Neck::list_beside(const Box& rim, const SweptMemory::Quad& sweep) {
  beside_.clear();
  cut_.work.add(walls_beside_.size(), cost::kWallsAUnit);
  for (const Wall& wall : walls_beside_) {
    if (!wall.triangle.around.meets(rim)) continue;
    const bool is_other = wall.quad == nullptr || wall.quad->stroke != sweep.stroke ||
                          std::abs(wall.quad->travel_m - sweep.travel_m) > kFar_h * cut_.h;
    if (is_other) beside_.push_back(wall.triangle);
  }
}

bool Neck::is_near_beside(const Vec3& p) const {
  return std::ranges::any_of(beside_, [&](const Triangle& t) {
    return t.around.has(p) && squared_length(closest_point(p, t.a, t.b, t.c) - p) <= gap_m() * gap_m();
  });
}

// Blocks the ways between neighbouring points that a triangle crosses; also at its edges, so that none slips through between two that share one.
void Neck::block(const Vec3& a, const Vec3& b, const Vec3& c) {
  constexpr double kEdge = 1e-9;
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
    Rows rows;
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
               static_cast<std::size_t>(y) * across] |= static_cast<std::uint8_t>(1u << axis);
      });
    }
    cut_.work.add(static_cast<std::size_t>(ws[1] - ws[0]) + 1, cost::kRowsAUnit);
  }
}

// The largest part of both sides that open ways connect. Of a side without a point nothing is known.
double Neck::shared(const Counts& counts) {
  if (std::min(counts[0], counts[1]) == 0) return 1;
  double most = 0;
  for (std::size_t i = 0; i < sides_.size(); ++i) {
    if (sides_[i] == 0) continue;
    const Counts part = follow(i);
    most = std::max(most, std::min(static_cast<double>(part[0]) / static_cast<double>(counts[0]),
                                   static_cast<double>(part[1]) / static_cast<double>(counts[1])));
  }
  return most;
}

Neck::Counts Neck::follow(std::size_t first) {
  Counts counts{};
  const auto take = [&](std::size_t at) {
    if (sides_[at] == 0) return;
    ++counts[sides_[at] - 1u];
    sides_[at] = 0;
    queue_.push_back(at);
  };
  queue_.clear();
  take(first);
  while (!queue_.empty()) {
    const std::size_t at = queue_.back();
    queue_.pop_back();
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const std::size_t step = step_[axis];
      if (!(walls_[at] >> axis & 1)) take(at + step);
      if (!(walls_[at - step] >> axis & 1)) take(at - step);
    }
  }
  return counts;
}

}  // namespace incise::core
