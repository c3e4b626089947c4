#include "server/core/stroke/swept_surface.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace incise::core {

namespace {

// Of a squared reach: far more than arithmetic loses, far less than anything that matters.
constexpr double kRounded = 1e-6;
// What is nearer than this part of a reach is within it, however that is rounded.
constexpr double kSurely = 0.999;
// A surface is flat if no normal is off another one by more than this, and it is so this part of its size beside it, too.
constexpr double kFlatWithin = 1e-9, kBesideFlat = 0.01;

}  // namespace

void SweptSurface::add_quad(const BladeLine& from, const BladeLine& to, int rows, int columns,
                            std::uint32_t batch, bool first, const Vec3& low, const Vec3& high) {
  const auto corner = [&](int row, int column) {
    // A grid point must have the same bits whichever quad it is computed for: on the first and last line only that
    // line's ends count.
    const double s = static_cast<double>(row) / rows, c = static_cast<double>(column) / columns;
    const Vec3 heel = row == 0 ? from.heel : row == rows ? to.heel : lerp(from.heel, to.heel, s);
    const Vec3 tip = row == 0 ? from.tip : row == rows ? to.tip : lerp(from.tip, to.tip, s);
    return column == 0 ? heel : column == columns ? tip : lerp(heel, tip, c);
  };
  // Halves the block of cells across its longer side, over and over: the list's order then makes a good tree.
  const auto add = [&](const auto& self, int row, int row_end, int column, int column_end) -> void {
    if (row_end - row > 1 || column_end - column > 1) {
      if (row_end - row >= column_end - column) {
        const int middle = row + (row_end - row) / 2;
        self(self, row, middle, column, column_end);
        self(self, middle, row_end, column, column_end);
      } else {
        const int middle = column + (column_end - column) / 2;
        self(self, row, row_end, column, middle);
        self(self, row, row_end, middle, column_end);
      }
      return;
    }
    const Vec3 a = corner(row, column), b = corner(row, column + 1);
    const Vec3 c = corner(row + 1, column + 1), d = corner(row + 1, column);
    if (std::max({a.x, b.x, c.x, d.x}) < low.x || std::min({a.x, b.x, c.x, d.x}) > high.x ||
        std::max({a.y, b.y, c.y, d.y}) < low.y || std::min({a.y, b.y, c.y, d.y}) > high.y ||
        std::max({a.z, b.z, c.z, d.z}) < low.z || std::min({a.z, b.z, c.z, d.z}) > high.z) {
      return;
    }
    SweptTriangle triangle;
    triangle.batch = batch;
    if (make_swept_triangle(a, b, c, triangle)) {
      triangle.rim = column + 1 == columns ? 2 : 0;
      if (row == 0) triangle.rim |= SweptTriangle::kStarts;
      if (row == 0 && first) triangle.rim |= 1;
      triangles_.push_back(triangle);
    }
    if (make_swept_triangle(a, c, d, triangle)) {
      triangle.rim = column == 0 ? 4 : 0;
      triangles_.push_back(triangle);
    }
  };
  add(add, 0, rows, 0, columns);
}

void SweptSurface::mark_turn(std::size_t begin, std::size_t end) {
  for (std::size_t i = begin; i < end; ++i) {
    if ((triangles_[i].rim & SweptTriangle::kStarts) != 0) triangles_[i].rim |= SweptTriangle::kTurns;
  }
}

void SweptSurface::add_strip(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d, std::uint32_t batch,
                             bool continues) {
  SweptTriangle triangle;
  triangle.batch = batch;
  triangle.rim = continues ? SweptTriangle::kContinues : 0;
  if (make_swept_triangle(a, b, c, triangle)) triangles_.push_back(triangle);
  if (make_swept_triangle(a, c, d, triangle)) triangles_.push_back(triangle);
}

void SweptSurface::build(std::size_t latest, const Box* around) {
  all_.build(triangles_, 0, built_, first_);
  built_ = triangles_.size();
  const std::size_t from = std::min(latest, triangles_.size());
  latest_.build(triangles_, from, from);
  find_flat_box(around);
}

void SweptSurface::find_flat_box(const Box* around) {
  flat_box_ = kNowhere;
  if (triangles().empty()) return;
  const SweptTriangle& first = triangles().front();
  const auto sign_of = [&](const SweptTriangle& s) { return dot(s.normal, first.normal) < 0 ? -1.0 : 1.0; };
  const auto turn_of = [&](const SweptTriangle& s) {
    const Vec3 by = sign_of(s) * s.normal - first.normal;
    return std::abs(by.x) + std::abs(by.y) + std::abs(by.z);
  };
  // What a hand sweeps bends soon.
  if (std::ranges::any_of(triangles(), [&](const SweptTriangle& s) { return turn_of(s) > kFlatWithin; }))
    return;
  Box box = kNowhere;
  for (const SweptTriangle& s : triangles()) box.add({s.low, s.high});
  if (around != nullptr) box.add(*around);
  const Vec3 middle = 0.5 * (box.low + box.high), half = (0.5 + kBesideFlat) * (box.high - box.low);
  const double reach_m = std::max({half.x, half.y, half.z});
  flat_off_m_ = 0;
  for (const SweptTriangle& s : triangles()) {
    const double sign = sign_of(s);
    const double at_middle = dot(sign * s.normal - first.normal, middle) - (sign * s.offset - first.offset);
    flat_off_m_ = std::max(flat_off_m_, std::abs(at_middle) + turn_of(s) * reach_m);
  }
  const Vec3 reach{reach_m, reach_m, reach_m};
  flat_box_ = {middle - reach, middle + reach};
}

std::size_t SweptSurface::drop_before(std::uint32_t oldest) {
  while (first_ < triangles_.size() && triangles_[first_].batch < oldest) ++first_;
  // Rebuilding the tree in every batch would be up to a tenth of what a wandering hand costs.
  if (first_ == 0 || 4 * first_ < triangles_.size()) return 0;
  triangles_.erase(triangles_.begin(), triangles_.begin() + static_cast<std::ptrdiff_t>(first_));
  built_ = 0;
  return std::exchange(first_, 0);
}

void SweptSurface::clear() {
  triangles_.clear();
  first_ = built_ = 0;
  build();
}

void SweptSurface::move(const AffineMotion& motion) {
  for (SweptTriangle& triangle : triangles_) triangle = moved(triangle, motion);
  built_ = 0;
}

bool SweptSurface::is_clearly_beyond(const Vec3& p, double reach) const {
  return flat_box_.has(p) &&
         std::abs(triangles_[first_].signed_distance(p)) - flat_off_m_ > (2 - kSurely) * reach;
}

bool SweptSurface::is_over(const Vec3& p, double reach, double clear_m) const {
  return any_near(p, reach, [&](const SweptTriangle& s) { return s.is_under(p, reach, clear_m); });
}

bool SweptSurface::near(const Vec3& p, double reach, Vec3& point, std::uint32_t& triangle) const {
  if (has(triangle)) {
    const SweptTriangle& s = triangles_[triangle];
    if (s.is_under(p, reach, 0)) {
      found_ = triangle;
      point = p - s.signed_distance(p) * s.normal;
      return true;
    }
  }
  return closest(p, reach, point, triangle, triangle);
}

bool SweptSurface::closest(const Vec3& p, double reach, Vec3& point, std::uint32_t& triangle,
                           std::uint32_t likely) const {
  if (is_clearly_beyond(p, reach)) return false;
  double best = reach * reach;
  // The closest is no farther than the likely one, but for what is rounded: which it is, the search decides.
  if (has(likely)) {
    const double d2 = squared_length(closest_point(p, triangles_[likely]) - p);
    best = std::min(best, d2 + kRounded * best);
  }
  bool found = false;
  all_.each_near(p, best, [&](std::uint32_t i) {
    const SweptTriangle& s = triangles_[i];
    const double plane = s.signed_distance(p);
    if (plane * plane >= best) return;
    const Vec3 q = closest_point(p, s);
    const double d2 = squared_length(q - p);
    if (d2 >= best) return;
    best = d2;
    point = q;
    triangle = i;
    found = true;
  });
  return found;
}

bool SweptSurface::is_within(const Vec3& p, double reach) const {
  return is_within(p, reach, 0);
}

bool SweptSurface::was_swept_within(const Vec3& p, double reach) const {
  return is_within(p, reach, SweptTriangle::kContinues);
}

bool SweptSurface::is_within(const Vec3& p, double reach, std::uint8_t without) const {
  if (is_clearly_beyond(p, reach)) return false;
  if (has(found_) && (triangles_[found_].rim & without) == 0 &&
      triangles_[found_].is_under(p, kSurely * reach, 0))
    return true;
  const double reach2 = reach * reach;
  return any_near(p, reach, [&](const SweptTriangle& s) {
    if ((s.rim & without) != 0) return false;
    const double plane = s.signed_distance(p);
    return plane * plane < reach2 && squared_length(closest_point(p, s) - p) < reach2;
  });
}

template <class Is>
bool SweptSurface::any_near(const Vec3& p, double reach, Is is) const {
  double left = reach * reach;
  bool found = false;
  all_.each_near(p, left, [&](std::uint32_t i) {
    if (found || !is(triangles_[i])) return;
    found = true;
    found_ = i;
    left = -1;  // nothing is as near
  });
  return found;
}

void SweptSurface::archive(Archive& io) {
  if (io.reads()) built_ = 0;
  std::uint64_t first = first_;
  io(first);
  io.list(triangles_, 253, [&](SweptTriangle& t) {
    for (Vec3& corner : t.corners) io(corner);
    io(t.normal);
    io(t.offset);
    io(t.low);
    io(t.high);
    for (Vec3& inward : t.inward) io(inward);
    for (double& offset : t.inward_offset) io(offset);
    io(t.batch);
    io(t.rim);
  });
  io.demand(first <= triangles_.size(), "more triangles forgotten than swept");
  first_ = io.failed() ? 0 : first;
}

}  // namespace incise::core
