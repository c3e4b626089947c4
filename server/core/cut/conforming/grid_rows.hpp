#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace incise::core {

// A value that is linear in two numbers.
struct Linear {
  double first = 0, by_j = 0, by_k = 0;
  double at(double j, double k) const { return first + by_j * j + by_k * k; }
  Linear times(double factor) const { return {factor * first, factor * by_j, factor * by_k}; }
};

// The points of a grid's rows along an axis that are inside some planes.
class GridRows {
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

}  // namespace incise::core
