#include "tests/oracle/sample_grid.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace incise::oracle {

SampleGrid::SampleGrid(const Vec3& low, const Vec3& high, double spacing) : spacing_(spacing) {
  // Off by odd parts of the spacing, so that planes through round coordinates meet no point.
  origin_ = low - spacing * Vec3{2.3819, 2.4142, 2.2361};
  const Vec3 extent = high - origin_;
  size_ = 1;
  for (int a = 0; a < 3; ++a) {
    count_[a] = static_cast<std::int64_t>(std::ceil(component(extent, a) / spacing)) + 3;
    step_[a] = size_;
    size_ *= static_cast<std::size_t>(count_[a]);
    if (size_ > 400'000'000) throw std::runtime_error("the body is too large for the oracle's grid");
  }
}

Vec3 SampleGrid::point(std::size_t index) const {
  const auto i = index % step_[1], j = index % step_[2] / step_[1], k = index / step_[2];
  return origin_ + spacing_ * Vec3{static_cast<double>(i), static_cast<double>(j), static_cast<double>(k)};
}

std::array<std::int64_t, 2> SampleGrid::range(double low, double high, int axis) const {
  const double last = static_cast<double>(count_[axis] - 1);
  return {static_cast<std::int64_t>(std::ceil(std::clamp(low, 0.0, last + 1))),
          static_cast<std::int64_t>(std::floor(std::clamp(high, -1.0, last))) + 1};
}

std::uint32_t flood(const SampleGrid& grid, const Walls& walls, const std::vector<std::uint8_t>& wanted,
                    std::vector<std::uint32_t>& parts) {
  parts.assign(grid.size(), core::kNone);
  std::vector<std::size_t> open;
  std::uint32_t count = 0;
  // The outermost layers of the grid are outside of the body, so that no step leaves the array.
  for (std::size_t seed = 0; seed < grid.size(); ++seed) {
    if (!wanted[seed] || parts[seed] != core::kNone) continue;
    parts[seed] = count;
    open.push_back(seed);
    const auto visit = [&](std::size_t next) {
      if (!wanted[next] || parts[next] != core::kNone) return;
      parts[next] = count;
      open.push_back(next);
    };
    while (!open.empty()) {
      const std::size_t at = open.back();
      open.pop_back();
      for (int a = 0; a < 3; ++a) {
        if (!(walls[at] >> a & 1)) visit(at + grid.step(a));
        const std::size_t below = at - grid.step(a);
        if (!(walls[below] >> a & 1)) visit(below);
      }
    }
    ++count;
  }
  return count;
}

}  // namespace incise::oracle
