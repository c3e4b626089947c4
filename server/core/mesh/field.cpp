#include "server/core/mesh/field.hpp"

#include <algorithm>

#include "protocol/blend.hpp"
#include "server/base/check.hpp"

namespace incise::core {

using protocol::blend;
using protocol::make_room;

Field rows_of(const Field& field, std::span<const std::uint32_t> rows) {
  Field out{field.name, field.on, field.components, {}};
  std::visit(
      [&](const auto& values) {
        auto& picked = out.values.emplace<std::decay_t<decltype(values)>>();
        picked.reserve(rows.size() * field.components);
        for (const std::uint32_t row : rows) {
          const auto first = values.begin() + static_cast<std::ptrdiff_t>(row * field.components);
          picked.insert(picked.end(), first, first + static_cast<std::ptrdiff_t>(field.components));
        }
      },
      field.values);
  return out;
}

template <class T>
void carry(const Delta& delta, std::size_t components, std::vector<T>& values) {
  const std::size_t before = delta.first_added, added = delta.provenance.size();
  INCISE_CHECK(values.size() == components * before, values.size(), components, before);
  // All blends read the state before the step, so they are known before one is written.
  std::vector<T> blended(components * delta.blends.size());
  for (std::size_t i = 0; i < delta.blends.size(); ++i)
    blend(values, components, delta.blends[i].from, delta.blends[i].weights, &blended[components * i]);
  make_room(values, components * (before + added));
  values.resize(components * (before + added));
  const auto row = [&](std::size_t id) {
    return values.begin() + static_cast<std::ptrdiff_t>(components * id);
  };
  for (std::size_t i = 0; i < delta.blends.size(); ++i)
    std::copy_n(&blended[components * i], components, row(delta.blends[i].vertex));
  auto next = std::lower_bound(delta.blends.begin(), delta.blends.end(), before,
                               [](const Blend& b, std::size_t id) { return b.vertex < id; });
  for (std::size_t i = 0; i < added; ++i) {
    if (next != delta.blends.end() && next->vertex == before + i) {
      ++next;
      continue;
    }
    const Provenance& p = delta.provenance[i];
    const VertexId parents[2] = {p.a, p.b};
    const double weights[2] = {1 - p.t, p.t};
    blend(values, components, parents, weights, &*row(before + i));
  }
}

template <class T>
void carry_tets(const Delta& delta, std::size_t components, std::vector<T>& values) {
  if (delta.elders.empty()) return;
  const auto tets = std::span(delta.upserted).last(delta.elders.size());
  const std::size_t rows = std::size_t{tets.back().id} + 1;
  make_room(values, components * rows);
  values.resize(components * rows);
  const auto row = [&](TetId t) { return values.begin() + static_cast<std::ptrdiff_t>(components * t); };
  for (std::size_t i = 0; i < tets.size(); ++i)
    std::copy_n(row(delta.elders[i]), components, row(tets[i].id));
}

template void carry(const Delta&, std::size_t, std::vector<float>&);
template void carry(const Delta&, std::size_t, std::vector<double>&);
template void carry(const Delta&, std::size_t, std::vector<std::int32_t>&);
template void carry(const Delta&, std::size_t, std::vector<std::int64_t>&);
template void carry_tets(const Delta&, std::size_t, std::vector<float>&);
template void carry_tets(const Delta&, std::size_t, std::vector<double>&);
template void carry_tets(const Delta&, std::size_t, std::vector<std::int32_t>&);
template void carry_tets(const Delta&, std::size_t, std::vector<std::int64_t>&);

}  // namespace incise::core
