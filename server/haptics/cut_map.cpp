#include "server/haptics/cut_map.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <new>
#include <utility>

namespace incise::haptics {
namespace {

using core::Vec3;

constexpr double kCell_h = 0.25, kAside_h = 0.1;
constexpr double kMostCells = 16e6;
constexpr double kAlong = 0.643;  // sine of 40 degrees
constexpr int kMostRows = 64;     // of points across a face

// The axes through the vertices of an icosahedron and of its dual: no direction is farther than 21 degrees from all.
const std::array<Vec3, 16> kDirections = [] {
  const double g = 0.5 * (1 + std::sqrt(5.0)), i = 1 / g;
  std::array<Vec3, 16> axes{Vec3{0, 1, g}, {0, -1, g}, {1, g, 0},  {-1, g, 0}, {g, 0, 1}, {g, 0, -1},
                            {1, 1, 1},     {-1, 1, 1}, {1, -1, 1}, {1, 1, -1}, {0, g, i}, {0, g, -i},
                            {i, 0, g},     {-i, 0, g}, {g, i, 0},  {g, -i, 0}};
  for (Vec3& axis : axes) axis = normalized(axis);
  return axes;
}();

CutMap::Directions nearest_direction(const Vec3& normal) noexcept {
  std::size_t best = 0;
  double most = -1;
  for (std::size_t i = 0; i < kDirections.size(); ++i) {
    const double cosine = std::abs(dot(kDirections[i], normal));
    if (cosine > most) {
      most = cosine;
      best = i;
    }
  }
  return static_cast<CutMap::Directions>(1u << best);
}

}  // namespace

CutMap::CutMap(const Vec3& low, const Vec3& high, double h) : origin_(low), aside_(kAside_h * h) {
  const Vec3 size = high - low;
  if (!(h > 0)) return;
  for (cell_ = kCell_h * h;; cell_ *= 1.2) {
    double cells = 1;
    int axis = 0;
    for (const double extent : {size.x, size.y, size.z}) {
      count_[axis] = static_cast<std::int64_t>(extent / cell_) + 1;
      cells *= static_cast<double>(count_[axis++]);
    }
    if (cells <= kMostCells) break;
  }
  inverse_ = 1 / cell_;
  cell_count_ = static_cast<std::size_t>(count_[0] * count_[1] * count_[2]);
  cells_.reset(static_cast<Directions*>(std::calloc(cell_count_, sizeof(Directions))));
  if (!cells_) throw std::bad_alloc();
  marked_.assign((cell_count_ + kStretch - 1) / kStretch, 0);
}

void CutMap::clear() noexcept {
  for (std::size_t i = 0; i < marked_.size(); ++i) {
    if (!std::exchange(marked_[i], std::uint8_t{0})) continue;
    const std::size_t begin = i * kStretch;
    std::fill_n(&cells_[begin], std::min(kStretch, cell_count_ - begin), Directions{0});
  }
  any_ = false;
}

std::size_t CutMap::index(const Vec3& p) const noexcept {
  const double x = (p.x - origin_.x) * inverse_, y = (p.y - origin_.y) * inverse_,
               z = (p.z - origin_.z) * inverse_;
  if (!(x >= 0 && y >= 0 && z >= 0 && x < static_cast<double>(count_[0]) &&
        y < static_cast<double>(count_[1]) && z < static_cast<double>(count_[2]))) {
    return cell_count_;
  }
  return static_cast<std::size_t>((static_cast<std::int64_t>(x) * count_[1] + static_cast<std::int64_t>(y)) *
                                      count_[2] +
                                  static_cast<std::int64_t>(z));
}

void CutMap::mark(const Vec3& a, const Vec3& b, const Vec3& c) noexcept {
  const Vec3 normal = normalized(cross(b - a, c - a));
  if (squared_length(normal) == 0) return;
  const Directions bit = nearest_direction(normal);
  const double longest = std::max({distance(a, b), distance(b, c), distance(c, a)});
  const int rows = static_cast<int>(std::clamp(std::ceil(2 * longest / cell_), 1.0, double{kMostRows}));
  const auto set = [&](const Vec3& p) {
    const std::size_t i = index(p);
    if (i >= cell_count_) return;
    cells_[i] = static_cast<Directions>(cells_[i] | bit);
    marked_[i / kStretch] = 1;
  };
  for (int i = 0; i <= rows; ++i) {
    for (int j = 0; i + j <= rows; ++j) {
      const Vec3 p =
          a + (static_cast<double>(i) / rows) * (b - a) + (static_cast<double>(j) / rows) * (c - a);
      set(p);
      set(p + aside_ * normal);
      set(p - aside_ * normal);
    }
  }
  any_ = true;
}

CutMap::Directions CutMap::at(const Vec3& p) const noexcept {
  const std::size_t i = index(p);
  return i < cell_count_ && marked_[i / kStretch] ? cells_[i] : Directions{0};
}

CutMap::Directions CutMap::along(const Vec3& edge) noexcept {
  Directions set = 0;
  for (std::size_t i = 0; i < kDirections.size(); ++i) {
    if (std::abs(dot(kDirections[i], edge)) <= kAlong) set = static_cast<Directions>(set | 1u << i);
  }
  return set;
}

}  // namespace incise::haptics
