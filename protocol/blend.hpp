#pragma once

// Standard library only: the core uses it, too.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>
#include <type_traits>
#include <vector>

namespace incise::protocol {

// One row of a field, `components` numbers, from rows of `values` by weights that add up to 1. Numbers with a fraction are interpolated
// in double precision, in the order given; an integer is that of the row with the largest weight, the first of these.
template <class T>
void blend(const std::vector<T>& values, std::size_t components, std::span<const std::uint32_t> from,
           std::span<const double> weights, T* to) {
  if constexpr (std::is_integral_v<T>) {
    const auto heaviest = std::max_element(weights.begin(), weights.end());
    const std::size_t row = from[static_cast<std::size_t>(heaviest - weights.begin())];
    std::copy_n(&values[components * row], components, to);
  } else {
    for (std::size_t c = 0; c < components; ++c) {
      double sum = 0;
      for (std::size_t j = 0; j < from.size(); ++j)
        sum += weights[j] * static_cast<double>(values[components * from[j] + c]);
      to[c] = static_cast<T>(sum);
    }
  }
}

// Room for so many values in all. Doubles what there is, so that a field that grows a little at each step is not copied at each.
template <class T>
void make_room(std::vector<T>& values, std::size_t count) {
  if (count > values.capacity()) values.reserve(std::max(count, 2 * values.capacity()));
}

}  // namespace incise::protocol
