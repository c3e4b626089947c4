#pragma once

// Values on the vertices or tetrahedra of a body, by name: temperatures, fibre directions, labels.

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "server/core/mesh/delta.hpp"

namespace incise::core {

inline constexpr std::size_t kMaxFieldComponents = 9;
inline constexpr std::size_t kMaxFieldName = 256;  // bytes
inline constexpr std::size_t kMaxFields = 256;

struct Field {
  enum class On : std::uint8_t { kVertices, kTets };

  std::string name;  // one of those on vertices, or on tetrahedra
  On on = On::kVertices;
  std::size_t components = 1;  // 1 to kMaxFieldComponents
  std::variant<std::vector<float>, std::vector<std::int32_t>>
      values;  // `components` for each; floats may be NaN

  std::size_t rows() const {
    return std::visit([this](const auto& v) { return v.size() / components; }, values);
  }
};

// Only these rows of a field, in this order.
Field rows_of(const Field& field, std::span<const std::uint32_t> rows);

// The values of a field on the vertices, `components` for each id, from the state before the delta to that after it: what
// protocol::carry() does with the delta as clients get it, to the bit. `values` has a row for each id below delta.first_added.
// For float, double, int32 and int64. O(blends + added vertices), but for the growth of the vector.
template <class T>
void carry(const Delta& delta, std::size_t components, std::vector<T>& values);
// The same for a field on the tetrahedra: what is new has the values of its elder; rows of ids without a tetrahedron are meaningless.
// `values` has a row for each elder.
// O(new tetrahedra), but for the growth of the vector.
template <class T>
void carry_tets(const Delta& delta, std::size_t components, std::vector<T>& values);

}  // namespace incise::core
