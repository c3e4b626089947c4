#include "server/core/cut/conforming/neck.hpp"

#include <algorithm>
#include <cmath>

namespace incise::core {

using namespace tolerance;

namespace {

double coordinate(const Vec3& p, int axis) {
  return axis == 0 ? p.x : axis == 1 ? p.y : p.z;
}

// The whole numbers from `low` to `high` that number points: first and last.
std::array<int, 2> range(double low, double high) {
  const double last = kNeckPoints - 1;
  return {static_cast<int>(std::clamp(std::ceil(low), 0.0, last + 1)),
          static_cast<int>(std::clamp(std::floor(high), -1.0, last))};
}

std::size_t point(int i, int j, int k) {
  const auto at = [](int n) { return static_cast<std::size_t>(n); };
  return at(i) + kNeckPoints * (at(j) + kNeckPoints * at(k));
}

// A ruled quad as two triangles.
template <class Visit>
void each_triangle(const SweptMemory::Quad& quad, Visit visit) {
  visit(quad.from.heel, quad.from.tip, quad.to.tip);
  visit(quad.from.heel, quad.to.tip, quad.to.heel);
}

}  // namespace

// Looks farther where one of the sides has little of itself near the face: how it lies beside a surface says little about it then.
bool Neck::is_closed(HalfFace h) {
  const HalfFace o = mesh_.opposite(h);
  const Vec3 middle = mesh_.face_middle(h);
  double face_m = 0;
  for (VertexId v : mesh_.face_vertices(h)) face_m = std::max(face_m, distance(mesh_.position(v), middle));
  // Of a larger one too little would be seen.
  if (face_m > kNeckReach_h[0] * cut_.h) return false;
  bool together = true;
  for (double reach_h : kNeckReach_h) {
    lay_out(middle, reach_h * cut_.h);
    pass_.begin();
    pass_.add(tet_of(o));
    const Counts counts{fill(tet_of(h), 1), fill(tet_of(o), 2)};
    block_swept();
    together = hang_together(counts);
    const double point_h3 = std::pow(step_m_ / cut_.h, 3);
    if (static_cast<double>(std::min(counts[0], counts[1])) * point_h3 >= kNeckPart_h3) break;
  }
  return !together;
}

void Neck::lay_out(const Vec3& middle, double reach_m) {
  cut_.work += cost::kNeck;
  step_m_ = 2 * reach_m / (kPoints - 1);
  const Vec3 r{reach_m, reach_m, reach_m};
  low_ = middle - r;
  high_ = middle + r;
  sides_.assign(kAll, 0);
  walls_.assign(kAll, 0);
  skin_.clear();
}

bool Neck::meets(const Vec3& low, const Vec3& high) const {
  return low.x <= high_.x && low.y <= high_.y && low.z <= high_.z && high.x >= low_.x && high.y >= low_.y &&
         high.z >= low_.z;
}

// Marks the points in what hangs together with a tetrahedron in the box, and blocks the ways through the boundary there. Returns how many there
// are.
std::size_t Neck::fill(TetId from, std::uint8_t side) {
  std::size_t count = 0;
  tets_.assign(1, from);
  pass_.add(from);
  for (std::size_t i = 0; i < tets_.size(); ++i) {
    const TetId t = tets_[i];
    cut_.work += cost::kLook;
    count += fill_tet(t, side);
    for (int f = 0; f < 4; ++f) {
      const HalfFace o = mesh_.opposite(half_face(t, f));
      if (o == kNone) {
        const auto v = mesh_.face_vertices(half_face(t, f));
        const Corners corners{mesh_.position(v[0]), mesh_.position(v[1]), mesh_.position(v[2])};
        block(corners);
        if (!(mesh_.cut_mask(t) >> f & 1)) skin_.push_back(corners);
        continue;
      }
      if (cut_.is_pending(o) || pass_.has(tet_of(o))) continue;
      Vec3 low = mesh_.position(mesh_.vertices(tet_of(o))[0]), high = low;
      for (VertexId v : mesh_.vertices(tet_of(o))) extend(mesh_.position(v), low, high);
      if (!meets(low, high)) continue;
      pass_.add(tet_of(o));
      tets_.push_back(tet_of(o));
    }
  }
  return count;
}

std::size_t Neck::fill_tet(TetId t, std::uint8_t side) {
  Vec3 p[4], inward[4];
  double offset[4];
  const auto& v = mesh_.vertices(t);
  for (int i = 0; i < 4; ++i) p[i] = to_grid(mesh_.position(v[i]));
  Vec3 low = p[0], high = p[0];
  for (int f = 0; f < 4; ++f) {
    extend(p[f], low, high);
    const Vec3& a = p[(f + 1) % 4];
    inward[f] = cross(p[(f + 2) % 4] - a, p[(f + 3) % 4] - a);
    if (dot(inward[f], p[f] - a) < 0) inward[f] = -inward[f];
    offset[f] = dot(inward[f], a);
  }
  const auto is = range(low.x, high.x), js = range(low.y, high.y), ks = range(low.z, high.z);
  std::size_t count = 0;
  for (int k = ks[0]; k <= ks[1]; ++k) {
    for (int j = js[0]; j <= js[1]; ++j) {
      for (int i = is[0]; i <= is[1]; ++i) {
        const Vec3 q{static_cast<double>(i), static_cast<double>(j), static_cast<double>(k)};
        bool inside = true;
        for (int f = 0; f < 4 && inside; ++f) inside = dot(inward[f], q) >= offset[f];
        std::uint8_t& at = sides_[point(i, j, k)];
        if (!inside || at != 0) continue;
        at = side;
        ++count;
      }
    }
  }
  return count;
}

// Blocks the ways through what was swept, and those through gaps to the skin or another sweep that are no wider than what is one.
void Neck::block_swept() {
  near_.clear();
  const Vec3 around{kOne_h * cut_.h, kOne_h * cut_.h, kOne_h * cut_.h};
  for (const SweptMemory::Quad& quad : cut_.workspace.swept.quads()) {
    Vec3 low = quad.from.heel, high = low;
    for (const Vec3& p : {quad.from.tip, quad.to.heel, quad.to.tip}) extend(p, low, high);
    if (!meets(low - around, high + around)) continue;
    near_.push_back(&quad);
    each_triangle(quad, [&](const Vec3& a, const Vec3& b, const Vec3& c) { block(a, b, c); });
  }
  cut_.work.add(cut_.workspace.swept.quads().size(), cost::kQuadsAUnit);
  for (const SweptMemory::Quad* quad : near_) {
    if (!quad->has_rims) continue;
    const BladeLine &from = quad->from, &to = quad->to;
    const Vec3 along = normalized((from.tip - from.heel) + (to.tip - to.heel));
    const Vec3 motion = (to.heel - from.heel) + (to.tip - from.tip);
    const Vec3 normal = normalized(cross(along, motion));
    lead_on(from.heel, to.heel, -along, normal, *quad);
    lead_on(from.tip, to.tip, along, normal, *quad);
  }
  SweepEnds& ends = cut_.workspace.ends;
  for (std::size_t i = 0; i < ends.size(); ++i) {
    const BladeLine &line = ends[i].lines[0], &before = ends[i].lines[1];
    const Vec3 along = normalized(line.tip - line.heel);
    const Vec3 motion = (line.heel - before.heel) + (line.tip - before.tip);
    const Vec3 away = normalized(motion - dot(motion, along) * along);
    lead_on(line.heel, line.tip, away, cross(along, away),
            {line, line, ends[i].stroke, ends[i].travel_m, true});
  }
}

// Leads a rim from a to b on to what is near.
void Neck::lead_on(const Vec3& a, const Vec3& b, const Vec3& away, const Vec3& normal,
                   const SweptMemory::Quad& sweep) {
  const double by_m = kOne_h * cut_.h;
  const Vec3 around{by_m, by_m, by_m};
  Vec3 low = a, high = a;
  extend(b, low, high);
  if (!meets(low - around, high + around)) return;
  const int count = std::max(1, static_cast<int>(std::ceil(distance(a, b) / (kNeckRim_h * cut_.h))));
  for (int i = 0; i < count; ++i) {
    const Vec3 p = lerp(a, b, static_cast<double>(i) / count),
               q = lerp(a, b, static_cast<double>(i + 1) / count);
    const Vec3 middle = lerp(p, q, 0.5);
    if (!meets(middle - around, middle + around) || !is_near_other(middle, sweep)) continue;
    for (const Vec3& direction : {away, normal, -normal}) {
      const Vec3 by = by_m * direction;
      block(p, q, q + by);
      block(p, q + by, p + by);
    }
  }
}

// Whether the skin is near, or another sweep, or quite another part of this one.
bool Neck::is_near_other(const Vec3& p, const SweptMemory::Quad& sweep) const {
  const double reach_m = kOne_h * cut_.h;
  const auto is_near = [&](const Vec3& a, const Vec3& b, const Vec3& c) {
    return squared_length(closest_point(p, a, b, c) - p) <= reach_m * reach_m;
  };
  cut_.work.add(skin_.size() + near_.size(), cost::kWallsAUnit);
  return std::ranges::any_of(skin_, [&](const Corners& t) { return is_near(t.a, t.b, t.c); }) ||
         std::ranges::any_of(near_, [&](const SweptMemory::Quad* other) {
           if (other->stroke == sweep.stroke && std::abs(other->travel_m - sweep.travel_m) <= kFar_h * cut_.h)
             return false;
           bool near = false;
           each_triangle(
               *other, [&](const Vec3& a, const Vec3& b, const Vec3& c) { near = near || is_near(a, b, c); });
           return near;
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
    const double area = (pu[1] - pu[0]) * (pw[2] - pw[0]) - (pw[1] - pw[0]) * (pu[2] - pu[0]);
    if (std::abs(area) < kEdge) continue;
    const auto us = range(std::min({pu[0], pu[1], pu[2]}) - kEdge, std::max({pu[0], pu[1], pu[2]}) + kEdge);
    const auto ws = range(std::min({pw[0], pw[1], pw[2]}) - kEdge, std::max({pw[0], pw[1], pw[2]}) + kEdge);
    for (int y = ws[0]; y <= ws[1]; ++y) {
      for (int x = us[0]; x <= us[1]; ++x) {
        double at = 0;
        bool inside = true;
        for (int i = 0; i < 3 && inside; ++i) {
          const int j = (i + 1) % 3, k = (i + 2) % 3;
          const double weight = ((pu[j] - x) * (pw[k] - y) - (pw[j] - y) * (pu[k] - x)) / area;
          inside = weight >= -kEdge;
          at += weight * coordinate(p[i], axis);
        }
        if (!inside || at < 0 || at >= kPoints - 1) continue;
        const auto n = static_cast<std::size_t>(at);
        const auto s = static_cast<std::size_t>(axis), t = static_cast<std::size_t>(u),
                   r = static_cast<std::size_t>(w);
        walls_[n * kStep[s] + static_cast<std::size_t>(x) * kStep[t] +
               static_cast<std::size_t>(y) * kStep[r]] |= static_cast<std::uint8_t>(1u << axis);
      }
    }
  }
}

// Whether open ways connect most of both sides.
bool Neck::hang_together(const Counts& counts) {
  for (std::size_t i = 0; i < kAll; ++i) {
    if (sides_[i] == 0) continue;
    const Counts part = follow(i);
    if (static_cast<double>(part[0]) >= kNeckShared * static_cast<double>(counts[0]) &&
        static_cast<double>(part[1]) >= kNeckShared * static_cast<double>(counts[1]))
      return true;
  }
  return false;
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
      const std::size_t step = kStep[axis], place = at / step % kPoints;
      if (place + 1 < kPoints && !(walls_[at] >> axis & 1)) take(at + step);
      if (place > 0 && !(walls_[at - step] >> axis & 1)) take(at - step);
    }
  }
  return counts;
}

}  // namespace incise::core
