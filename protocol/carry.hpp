#pragma once

// Fields that a client carries on the vertices and tetrahedra of view Volume (temperature, displacement, a label), over a delta.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "protocol/blend.hpp"
#include "protocol/messages.hpp"

namespace incise::protocol {

// The rounds of a delta, one after the other: which of its blends and of its added vertices belong to each. A delta without
// round_blends is one round.
class BlendRounds {
 public:
  explicit BlendRounds(const Delta& delta)
      : delta_(delta), first_vertex_(delta.vertex_count - delta.provenance_t.size()) {}
  // The next round, to begin with the first. False behind the last.
  bool next();

  std::size_t first_blend() const { return first_blend_; }
  std::size_t blends() const { return blends_; }
  std::size_t first_added() const { return first_added_; }  // counted from the delta's first one
  std::size_t added() const { return added_; }
  std::size_t vertices_before() const { return first_vertex_ + first_added_; }

 private:
  const Delta& delta_;
  std::size_t first_vertex_;
  std::size_t round_ = 0, first_blend_ = 0, blends_ = 0, first_added_ = 0, added_ = 0;
};

// What is wrong with a delta's provenance and blends, given that so many vertices were there before; empty if nothing. O(delta).
std::string provenance_error(const Delta& delta, std::size_t vertices);

// The same of its elders, given that ids of tetrahedra ran below `slots`.
std::string elders_error(const Delta& delta, std::size_t slots);

// The values of a field on the vertices, `components` (1 or more) for each, go from the state at delta.base_revision to that at
// delta.revision. Numbers with a fraction are interpolated (in double precision); an integer is that of the vertex with the
// largest weight, the first of these. Throws std::invalid_argument, and changes nothing, where the values or the delta's
// lists do not fit. Not for a delta of a box. O(blends + added vertices), but for the growth of the vector.
template <class T>
void carry(const Delta& delta, std::size_t components, std::vector<T>& values) {
  const std::size_t vertices =
      delta.vertex_count - std::min<std::size_t>(delta.vertex_count, delta.provenance_t.size());
  if (components == 0 || values.size() != components * vertices) {
    throw std::invalid_argument("carry: " + std::to_string(values.size()) + " values, expected " +
                                std::to_string(components) + " for each of " + std::to_string(vertices) +
                                " vertices");
  }
  if (const std::string error = provenance_error(delta, vertices); !error.empty())
    throw std::invalid_argument("carry: " + error);
  std::vector<T>
      blended;  // those of a round read the state before it, so all are known before one is written
  make_room(values, components * delta.vertex_count);
  for (BlendRounds round(delta); round.next();) {
    const std::size_t before = round.vertices_before();
    blended.resize(components * round.blends());
    for (std::size_t i = 0; i < round.blends(); ++i) {
      const std::size_t at = 4 * (round.first_blend() + i);
      blend(values, components, delta.blend_vertices.subspan(at, 4), delta.blend_weights.subspan(at, 4),
            &blended[components * i]);
    }
    values.resize(components * (before + round.added()));
    const auto ids = delta.blend_ids.subspan(round.first_blend(), round.blends());
    for (std::size_t i = 0; i < ids.size(); ++i) {
      for (std::size_t c = 0; c < components; ++c)
        values[components * ids[i] + c] = blended[components * i + c];
    }
    std::size_t next = 0;  // of ids
    for (std::size_t i = 0; i < round.added(); ++i) {
      while (next < ids.size() && ids[next] < before + i) ++next;
      if (next < ids.size() && ids[next] == before + i) continue;
      const std::size_t at = round.first_added() + i;
      const std::uint32_t parents[2] = {delta.provenance_a[at], delta.provenance_b[at]};
      const double t = delta.provenance_t[at];
      const double weights[2] = {1 - t, t};
      blend(values, components, parents, weights, &values[components * (before + i)]);
    }
  }
}

// The same for a field on the tetrahedra, `components` for each id below the replica's tet_slots(): what is new has the values of its
// elder. The values of ids without a tetrahedron are meaningless. Throws std::invalid_argument, and changes nothing, where an elder
// or new tetrahedron does not fit. O(new tetrahedra), but for the growth of the vector.
template <class T>
void carry_tets(const Delta& delta, std::size_t components, std::vector<T>& values) {
  if (components == 0 || values.size() % components != 0)
    throw std::invalid_argument("carry_tets: not " + std::to_string(components) +
                                " values for each tetrahedron");
  const std::size_t slots = values.size() / components, n = delta.tet_elders.size();
  if (const std::string error = elders_error(delta, slots); !error.empty())
    throw std::invalid_argument("carry_tets: " + error);
  if (n == 0) return;
  const auto ids = delta.tets.ids.last(n);
  make_room(values, components * (std::size_t{ids.back()} + 1));
  values.resize(components * (std::size_t{ids.back()} + 1));
  for (std::size_t i = 0; i < n; ++i) {
    std::copy_n(values.begin() + static_cast<std::ptrdiff_t>(components * delta.tet_elders[i]), components,
                values.begin() + static_cast<std::ptrdiff_t>(components * ids[i]));
  }
}

}  // namespace incise::protocol
