#include "protocol/coalesce.hpp"

#include <algorithm>
#include <map>
#include <stdexcept>
#include <utility>
#include <vector>

#include "protocol/carry.hpp"

namespace incise::protocol {
namespace {

template <class T>
void append(std::vector<T>& out, std::span<const T> values) {
  out.insert(out.end(), values.begin(), values.end());
}

// Where the newest entry of each id stands: entry `index` of delta `delta`, or its removal.
class Places {
 public:
  struct Place {
    std::uint32_t id;
    std::uint32_t delta;
    std::uint32_t index;
    bool removed;
  };

  // Of one delta after the other, the newest first; of each delta first what it removes. Ids ascend.
  void note(std::span<const std::uint32_t> ids, std::size_t delta, bool removed) {
    if (ids.empty()) return;
    if (seen_.empty() && ids.size() > ids.back() / 64 + 64) begin_seeing(ids.back());
    const std::size_t before = places_.size();
    for (std::size_t i = 0; i < ids.size(); ++i) {
      if (seen_.empty() || see(ids[i]))
        places_.push_back(
            {ids[i], static_cast<std::uint32_t>(delta), static_cast<std::uint32_t>(i), removed});
    }
    if (places_.size() > before) ends_.push_back(places_.size());
  }

  // By id, each once. O(n log lists), after which nothing may be added: some lists have an entry for each vertex of a body, and most
  // have a few.
  const std::vector<Place>& settled() {
    while (ends_.size() > 1) {
      std::vector<std::size_t> ends;
      auto first = places_.begin();
      for (std::size_t k = 0; k < ends_.size(); k += 2) {
        const std::size_t end = ends_[std::min(k + 1, ends_.size() - 1)];
        const auto last = places_.begin() + static_cast<std::ptrdiff_t>(end);
        // Of the same id, the newer ones come first.
        std::inplace_merge(first, places_.begin() + static_cast<std::ptrdiff_t>(ends_[k]), last, before);
        first = last;
        ends.push_back(end);
      }
      ends_ = std::move(ends);
    }
    places_.erase(std::unique(places_.begin(), places_.end(),
                              [](const Place& a, const Place& b) { return a.id == b.id; }),
                  places_.end());
    return places_;
  }

  // Of what settled() gave: whether the id was removed last.
  bool removed(std::uint32_t id) const {
    const auto place = std::lower_bound(places_.begin(), places_.end(), Place{id, 0, 0, false}, before);
    return place != places_.end() && place->id == id && place->removed;
  }

 private:
  static bool before(const Place& a, const Place& b) { return a.id < b.id; }
  // From a list on that has most ids of a body, older entries of these are passed over: so a body that deforms costs its vertices once,
  // however many steps there are.
  void begin_seeing(std::uint32_t highest) {
    seen_.resize(highest / 64 + 1);
    for (const Place& place : places_) see(place.id);
  }
  // True the first time.
  bool see(std::uint32_t id) {
    if (id / 64 >= seen_.size()) seen_.resize(id / 64 + 1);
    const std::uint64_t bit = std::uint64_t{1} << (id % 64);
    if ((seen_[id / 64] & bit) != 0) return false;
    seen_[id / 64] |= bit;
    return true;
  }

  std::vector<Place> places_;        // list after list
  std::vector<std::size_t> ends_;    // of the lists
  std::vector<std::uint64_t> seen_;  // a bit for each id; empty: not yet
};

template <class D>
void check_chain(std::span<const D> deltas) {
  if (deltas.empty()) throw std::invalid_argument("coalesce: no delta");
  for (std::size_t i = 1; i < deltas.size(); ++i) {
    if (deltas[i].base_revision != deltas[i - 1].revision) {
      throw std::invalid_argument("coalesce: a delta from revision " +
                                  std::to_string(deltas[i].base_revision) + " after one to " +
                                  std::to_string(deltas[i - 1].revision));
    }
  }
}

bool deforms(const Delta& d) {
  return std::any_of(d.steps.begin(), d.steps.end(), [](const Step& step) { return step.stroke == 0; });
}

// The rest positions that the deltas change together. A cut before the first deformation lists none: there they are the
// positions that it sets, which a later one of these deltas may change.
void join_rest(std::span<const Delta> deltas, OwnedDelta& out) {
  if (std::none_of(deltas.begin(), deltas.end(),
                   [](const Delta& d) { return deforms(d) || !d.rest_ids.empty(); })) {
    return;
  }
  std::map<std::uint32_t, const double*> rest;
  for (const Delta& d : deltas) {
    if (!d.rest_ids.empty() || deforms(d)) {
      for (std::size_t i = 0; i < d.rest_ids.size(); ++i) rest[d.rest_ids[i]] = &d.rest_positions[3 * i];
      continue;
    }
    for (std::size_t i = 0; i < d.moved_ids.size(); ++i) rest[d.moved_ids[i]] = &d.moved_positions[3 * i];
    for (std::size_t i = 0; i < d.provenance_t.size(); ++i)
      rest[d.first_added + static_cast<std::uint32_t>(i)] = &d.added_positions[3 * i];
  }
  for (const auto& [id, position] : rest) {
    out.rest_ids.push_back(id);
    out.rest_positions.insert(out.rest_positions.end(), position, position + 3);
  }
}

// The rounds of the deltas, one after the other. One without blends only adds vertices, which its predecessor may do as well: so
// it does not matter how deltas are put together.
void join_rounds(std::span<const Delta> deltas, OwnedDelta& out) {
  for (const Delta& d : deltas) {
    append(out.blend_ids, d.blend_ids);
    append(out.blend_vertices, d.blend_vertices);
    append(out.blend_weights, d.blend_weights);
    for (BlendRounds round(d); round.next();) {
      if (out.round_added.empty() || round.blends() > 0) {
        out.round_added.push_back(0);
        out.round_blends.push_back(static_cast<std::uint32_t>(round.blends()));
      }
      out.round_added.back() += static_cast<std::uint32_t>(round.added());
    }
  }
  if (out.round_added.size() > 1) return;
  out.round_added.clear();
  out.round_blends.clear();
}

// Of each tetrahedron that one of the deltas makes: which one from before all of them is its elder.
std::map<std::uint32_t, std::uint32_t> elders_of(std::span<const Delta> deltas) {
  std::map<std::uint32_t, std::uint32_t> elders;
  for (const Delta& d : deltas) {
    const std::size_t first = d.tets.ids.size() - d.tet_elders.size();
    for (std::size_t i = 0; i < d.tet_elders.size(); ++i) {
      const auto older = elders.find(d.tet_elders[i]);
      elders[d.tets.ids[first + i]] = older == elders.end() ? d.tet_elders[i] : older->second;
    }
  }
  return elders;
}

}  // namespace

Delta OwnedDelta::view() const {
  Delta d;
  d.base_revision = base_revision;
  d.revision = revision;
  d.steps = steps;
  d.moved_ids = moved_ids;
  d.moved_positions = moved_positions;
  d.first_added = first_added;
  d.added_positions = added_positions;
  d.provenance_a = provenance_a;
  d.provenance_b = provenance_b;
  d.provenance_t = provenance_t;
  d.tets = {tet_ids, tet_vertices, tet_regions, tet_cut_masks, tet_boundary_masks};
  d.removed_tets = removed_tets;
  d.boundary_upserted = boundary_upserted;
  d.boundary_removed = boundary_removed;
  d.piece_ids = piece_ids;
  d.piece_sizes = piece_sizes;
  d.piece_tets = piece_tets;
  d.piece_names = piece_names;
  d.vertex_count = vertex_count;
  d.live_tets = live_tets;
  d.state_hash = state_hash;
  d.first_new_tet = first_new_tet;
  d.added_ids = added_ids;
  d.removed_vertices = removed_vertices;
  d.part_hash = part_hash;
  d.rest_ids = rest_ids;
  d.rest_positions = rest_positions;
  d.blend_ids = blend_ids;
  d.blend_vertices = blend_vertices;
  d.blend_weights = blend_weights;
  d.round_added = round_added;
  d.round_blends = round_blends;
  d.tet_elders = tet_elders;
  return d;
}

SurfaceDelta OwnedSurfaceDelta::view() const {
  return {base_revision,
          revision,
          steps,
          change.vertices(),
          change.removed_vertices,
          change.triangles(),
          change.removed_triangles,
          surface_hash,
          state_hash,
          live_tets,
          change.rest()};
}

OwnedDelta coalesce(std::span<const Delta> deltas) {
  check_chain(deltas);
  const Delta& first = deltas.front();
  const Delta& last = deltas.back();
  OwnedDelta out;
  out.base_revision = first.base_revision;
  out.revision = last.revision;
  out.vertex_count = last.vertex_count;
  out.live_tets = last.live_tets;
  out.state_hash = last.state_hash;
  out.first_new_tet = first.first_new_tet;
  out.first_added = first.vertex_count - static_cast<std::uint32_t>(first.provenance_t.size());

  join_rest(deltas, out);
  join_rounds(deltas, out);
  const std::map<std::uint32_t, std::uint32_t> elders = elders_of(deltas);
  Places moved, tets, faces;
  struct Piece {
    std::uint32_t tet, tets;
  };
  std::map<std::uint32_t, Piece> pieces;  // by id, as the last one named it
  for (std::size_t k = 0; k < deltas.size(); ++k) {
    const Delta& d = deltas[k];
    out.steps.insert(out.steps.end(), d.steps.begin(), d.steps.end());
    append(out.added_positions, d.added_positions);
    append(out.provenance_a, d.provenance_a);
    append(out.provenance_b, d.provenance_b);
    append(out.provenance_t, d.provenance_t);
    for (std::size_t p = 0; p < d.piece_ids.size(); ++p)
      pieces[d.piece_ids[p]] = {d.piece_names[p], d.piece_sizes[p]};
  }
  for (std::size_t k = deltas.size(); k-- > 0;) {
    const Delta& d = deltas[k];
    moved.note(d.moved_ids, k, false);
    tets.note(d.removed_tets, k, true);
    tets.note(d.tets.ids, k, false);
    faces.note(d.boundary_removed, k, true);
    faces.note(d.boundary_upserted, k, false);
  }

  for (const auto& [id, delta, index, removed] : moved.settled()) {
    const double* position = &deltas[delta].moved_positions[3 * std::size_t{index}];
    if (id >= out.first_added) {  // added in one of these deltas, moved in a later one
      std::copy_n(position, 3, &out.added_positions[3 * std::size_t{id - out.first_added}]);
      continue;
    }
    out.moved_ids.push_back(id);
    out.moved_positions.insert(out.moved_positions.end(), position, position + 3);
  }
  for (const auto& [id, delta, index, removed] : tets.settled()) {
    if (removed) {
      if (id < out.first_new_tet) out.removed_tets.push_back(id);
      continue;
    }
    const TetArrays& t = deltas[delta].tets;
    out.tet_ids.push_back(id);
    if (const auto elder = elders.find(id); elder != elders.end()) out.tet_elders.push_back(elder->second);
    append(out.tet_vertices, t.vertices.subspan(4 * std::size_t{index}, 4));
    out.tet_regions.push_back(t.regions[index]);
    out.tet_cut_masks.push_back(t.cut_masks[index]);
    out.tet_boundary_masks.push_back(t.boundary_masks[index]);
  }
  const auto first_new = std::lower_bound(out.tet_ids.begin(), out.tet_ids.end(), out.first_new_tet);
  if (static_cast<std::ptrdiff_t>(out.tet_elders.size()) != out.tet_ids.end() - first_new)
    out.tet_elders.clear();  // some of the deltas have none
  for (const auto& [half_face, delta, index, removed] : faces.settled()) {
    if (!removed) {
      out.boundary_upserted.push_back(half_face);
    } else if (half_face / 4 < out.first_new_tet) {
      out.boundary_removed.push_back(half_face);
    }
  }
  for (const auto& [id, piece] : pieces) {
    // A piece that loses its tetrahedron and gets no other is gone.
    if (tets.removed(piece.tet)) continue;
    out.piece_ids.push_back(id);
    out.piece_names.push_back(piece.tet);
    out.piece_sizes.push_back(piece.tets);
  }
  return out;
}

OwnedSurfaceDelta coalesce(std::span<const SurfaceDelta> deltas) {
  check_chain(deltas);
  const SurfaceDelta& last = deltas.back();
  OwnedSurfaceDelta out;
  out.base_revision = deltas.front().base_revision;
  out.revision = last.revision;
  out.surface_hash = last.surface_hash;
  out.state_hash = last.state_hash;
  out.live_tets = last.live_tets;

  Places vertices, triangles, rest;
  for (const SurfaceDelta& d : deltas) out.steps.insert(out.steps.end(), d.steps.begin(), d.steps.end());
  for (std::size_t k = deltas.size(); k-- > 0;) {
    const SurfaceDelta& d = deltas[k];
    vertices.note(d.removed_vertices, k, true);
    vertices.note(d.vertices.ids, k, false);
    triangles.note(d.removed_triangles, k, true);
    triangles.note(d.triangles.ids, k, false);
    rest.note(d.removed_vertices, k, true);
    rest.note(d.rest.ids, k, false);
  }
  SurfaceChange& c = out.change;
  for (const auto& [id, delta, index, removed] : vertices.settled()) {
    if (removed) {
      c.removed_vertices.push_back(id);
      continue;
    }
    c.vertex_ids.push_back(id);
    append(c.vertex_positions, deltas[delta].vertices.positions.subspan(3 * std::size_t{index}, 3));
  }
  for (const auto& [id, delta, index, removed] : triangles.settled()) {
    if (removed) {
      c.removed_triangles.push_back(id);
      continue;
    }
    const TriangleArrays& t = deltas[delta].triangles;
    c.triangle_ids.push_back(id);
    append(c.triangle_vertices, t.vertices.subspan(3 * std::size_t{index}, 3));
    c.triangle_flags.push_back(t.flags[index]);
    c.triangle_pieces.push_back(t.pieces[index]);
    c.triangle_regions.push_back(t.regions[index]);
    c.triangle_origins.push_back(t.origins.empty() ? kNoId : t.origins[index]);
  }
  if (std::all_of(c.triangle_origins.begin(), c.triangle_origins.end(),
                  [](std::uint32_t origin) { return origin == kNoId; })) {
    c.triangle_origins.clear();
  }
  for (const auto& [id, delta, index, removed] : rest.settled()) {
    if (removed) continue;
    c.rest_ids.push_back(id);
    append(c.rest_positions, deltas[delta].rest.positions.subspan(3 * std::size_t{index}, 3));
  }
  return out;
}

}  // namespace incise::protocol
