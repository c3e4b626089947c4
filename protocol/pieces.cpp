// Which tetrahedra hang together: what Replica says of pieces.

#include <numeric>
#include <vector>

#include "protocol/box_follow.hpp"
#include "protocol/replica.hpp"

namespace incise::protocol {

// By vertices: all tetrahedra at a vertex hang together through faces.
void Replica::find_pieces() const {
  state_.pieces_known = true;
  if (state_.names.empty()) {
    state_.pieces.assign(tet_slots(), 0);
    return;
  }
  std::vector<std::uint32_t> parent(vertex_count());
  std::iota(parent.begin(), parent.end(), 0u);
  const auto root = [&](std::uint32_t v) {
    while (parent[v] != v) v = parent[v] = parent[parent[v]];
    return v;
  };
  for_each_tet([&](std::uint32_t t) {
    const auto& v = vertices(t);
    const std::uint32_t r = root(v[0]);
    for (int k = 1; k < 4; ++k) parent[root(v[k])] = r;
  });
  std::vector<std::uint32_t> piece_of(vertex_count(), 0);
  for (const auto& [id, tet] : state_.names) {
    if (alive(tet)) piece_of[root(vertices(tet)[0])] = id;
  }
  state_.pieces.assign(tet_slots(), 0);
  for_each_tet([&](std::uint32_t t) { state_.pieces[t] = piece_of[root(vertices(t)[0])]; });
}

void Replica::follow_pieces(const TetIndex& index, const Delta& delta, std::vector<std::uint32_t>& changed) {
  std::vector<std::uint32_t>& pieces = state_.pieces;
  pieces.resize(tet_slots(), 0);
  for (const std::uint32_t t : delta.removed_tets) pieces[t] = 0;
  std::vector<std::uint32_t> unknown;
  for (const std::uint32_t t : delta.tets.ids) {
    if (t < delta.first_new_tet) continue;
    pieces[t] = kNoId;
    unknown.push_back(t);
  }
  std::vector<std::uint32_t> waiting, beside;
  for (std::size_t p = 0; p < delta.piece_ids.size(); ++p) {
    const std::uint32_t id = delta.piece_ids[p];
    const auto take = [&](std::uint32_t t) {
      if (pieces[t] == id) return;
      if (pieces[t] != kNoId) changed.push_back(t);
      pieces[t] = id;
      waiting.push_back(t);
    };
    take(delta.piece_names[p]);
    while (!waiting.empty()) {
      const std::array<std::uint32_t, 4> v = vertices(waiting.back());
      waiting.pop_back();
      for (const std::uint32_t vertex : v) {
        beside.clear();
        index.append_tets(vertex, beside);
        for (const std::uint32_t t : beside) take(t);
      }
    }
  }
  // New ones are in the piece of what is beside them; where all that is new, too, one of the next rounds finds it.
  for (bool found = true; found;) {
    found = false;
    std::erase_if(unknown, [&](std::uint32_t t) {
      for (const std::uint32_t vertex : vertices(t)) {
        if (pieces[t] != kNoId) break;
        beside.clear();
        index.append_tets(vertex, beside);
        for (const std::uint32_t other : beside) {
          if (pieces[other] != kNoId) pieces[t] = pieces[other];
        }
      }
      const bool known = pieces[t] != kNoId;
      found = found || known;
      return known;
    });
  }
  for (const std::uint32_t t : unknown) pieces[t] = 0;
  state_.pieces_known = true;
}

}  // namespace incise::protocol
