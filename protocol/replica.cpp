#include "protocol/replica.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>

#include "protocol/apply_checks.hpp"
#include "protocol/carry.hpp"
#include "protocol/state_hash.hpp"
#include "protocol/vertex_hashes.hpp"
#include "server/base/hex.hpp"

namespace incise::protocol {
namespace {

bool fits(const TetArrays& t) {
  const std::size_t n = t.ids.size();
  return t.vertices.size() == 4 * n && t.regions.size() == n && t.cut_masks.size() == n &&
         t.boundary_masks.size() == n;
}

// Checks the vertices and masks of entry i. `vertex_limit`: ids run below it.
ApplyResult check_tet(const TetArrays& t, std::size_t i, std::uint32_t vertex_limit) {
  const std::uint32_t* v = &t.vertices[4 * i];
  for (int k = 0; k < 4; ++k) {
    if (v[k] >= vertex_limit) {
      return refuse(ApplyError::BadIndex, "tetrahedron " + number(t.ids[i]) + ": vertex " + number(v[k]) +
                                              ", accepted are those below " + number(vertex_limit));
    }
  }
  if (v[0] == v[1] || v[0] == v[2] || v[0] == v[3] || v[1] == v[2] || v[1] == v[3] || v[2] == v[3]) {
    return refuse(ApplyError::BadIndex, "tetrahedron " + number(t.ids[i]) + ": a vertex twice");
  }
  if ((t.cut_masks[i] | t.boundary_masks[i]) > 15) {
    return refuse(ApplyError::BadShape, "tetrahedron " + number(t.ids[i]) + ": a mask bit above 3");
  }
  return {};
}

ApplyResult check_ascending(const char* what, std::span<const std::uint32_t> ids) {
  for (std::size_t i = 1; i < ids.size(); ++i) {
    if (ids[i] <= ids[i - 1]) {
      return refuse(ApplyError::BadIndex, std::string(what) + " " + number(ids[i]) + " after " +
                                              number(ids[i - 1]) + ", accepted are ascending ids");
    }
  }
  return {};
}

// The hash of the vertices id(i) below `count`, whose coordinates are at position(i).
template <class Id, class Position>
std::uint64_t hash_vertices(std::size_t count, Id id, Position position) {
  return VertexHashes::combined(count, id, [&](std::size_t i) {
    const double* p = position(i);
    return std::array{p[0], p[1], p[2]};
  });
}

// The same of ids from `first` on, with coordinates from `positions` on.
std::uint64_t hash_vertices(std::size_t first, std::span<const double> positions) {
  return hash_vertices(
      positions.size() / 3, [=](std::size_t i) { return static_cast<std::uint32_t>(first + i); },
      [=](std::size_t i) { return &positions[3 * i]; });
}

std::uint64_t hash_entry(const TetArrays& t, std::size_t i) {
  return tet_hash(t.ids[i], &t.vertices[4 * i], t.regions[i], t.cut_masks[i]);
}

}  // namespace

void Replica::State::resize_tets(std::size_t slots) {
  tets.resize(slots, {kNoId, kNoId, kNoId, kNoId});
  if (!regions.empty()) regions.resize(slots);
  cut_masks.resize(slots);
  boundary_masks.resize(slots);
}

void Replica::State::set_tet(const TetArrays& t, std::size_t i) {
  const std::uint32_t id = t.ids[i];
  std::copy_n(&t.vertices[4 * i], 4, tets[id].begin());
  if (t.regions[i] != 0 && regions.empty()) regions.resize(tets.size());
  if (!regions.empty()) regions[id] = t.regions[i];
  cut_masks[id] = t.cut_masks[i];
  boundary_faces += static_cast<std::uint32_t>(std::popcount(t.boundary_masks[i]));
  boundary_masks[id] = t.boundary_masks[i];
}

std::array<std::uint32_t, 3> Replica::face_vertices(std::uint32_t tet, int face) const {
  const auto& v = state_.tets[tet];
  const auto& f = kFaceVertices[face];
  return {v[f[0]], v[f[1]], v[f[2]]};
}

std::uint64_t Replica::compute_state_hash() const {
  std::uint64_t hash = 0;
  hash ^= hash_vertices(0, state_.positions);
  for_each_tet([&](std::uint32_t t) { hash ^= tet_hash(t, vertices(t).data(), region(t), cut_mask(t)); });
  return hash;
}

// ---- Whole states ----

Replica& Replica::operator=(const Replica& other) {
  if (this == &other) return *this;
  max_vertices_ = other.max_vertices_;
  max_tets_ = other.max_tets_;
  staged_.reset();
  if (state_.tets.capacity() > 2 * other.state_.tets.size()) state_ = {};
  state_ = other.state_;
  return *this;
}

ApplyResult Replica::add(State& state, std::uint32_t& next_tet, std::uint32_t vertex_limit,
                         const TetArrays& tets) const {
  if (!fits(tets)) {
    return refuse(ApplyError::BadShape, "tetrahedra: arrays of different lengths");
  }
  if (tets.ids.empty()) return {};
  if (ApplyResult r = check_ascending("tetrahedron", tets.ids); !r) return r;
  if (tets.ids.front() < next_tet) {
    return refuse(ApplyError::BadIndex, "tetrahedron " + number(tets.ids.front()) + " after " +
                                            number(next_tet - 1) + ", accepted are ascending ids");
  }
  if (tets.ids.back() >= max_tets_) {
    return refuse(ApplyError::LimitReached,
                  "tetrahedron " + number(tets.ids.back()) + ", the limit is " + number(max_tets_));
  }
  for (std::size_t i = 0; i < tets.ids.size(); ++i) {
    if (ApplyResult r = check_tet(tets, i, vertex_limit); !r) return r;
  }
  state.resize_tets(tets.ids.back() + std::size_t{1});
  for (std::size_t i = 0; i < tets.ids.size(); ++i) {
    state.set_tet(tets, i);
    state.hash ^= hash_entry(tets, i);
  }
  state.live_tets += static_cast<std::uint32_t>(tets.ids.size());
  next_tet = tets.ids.back() + 1;
  return {};
}

ApplyResult Replica::load(std::span<const double> positions, const TetArrays& tets, std::uint64_t revision) {
  const std::size_t count = positions.size() / 3;
  if (positions.size() % 3 != 0) return refuse(ApplyError::BadShape, "positions: not three for each vertex");
  if (count > max_vertices_) {
    return refuse(ApplyError::LimitReached,
                  number(count) + " vertices, the limit is " + number(max_vertices_));
  }
  State state;
  state.revision = revision;
  state.positions.assign(positions.begin(), positions.end());
  const auto vertices = static_cast<std::uint32_t>(count);
  state.vertices_hash = hash_vertices(0, positions);
  state.hash ^= state.vertices_hash;
  std::uint32_t next_tet = 0;
  if (ApplyResult r = add(state, next_tet, vertices, tets); !r) return r;
  state_ = std::move(state);
  staged_.reset();
  return {};
}

ApplyResult Replica::abandon(ApplyResult why) {
  staged_.reset();
  return why;
}

ApplyResult Replica::begin(const SnapshotBegin& part) {
  staged_.reset();
  if (part.view != View::Volume) return refuse(ApplyError::BadShape, "snapshot of another view than Volume");
  if (part.vertex_count > max_vertices_ || part.tet_count > max_tets_) {
    return refuse(ApplyError::LimitReached, "snapshot of " + number(part.vertex_count) + " vertices and " +
                                                number(part.tet_count) + " tetrahedra, the limits are " +
                                                number(max_vertices_) + " and " + number(max_tets_));
  }
  staged_ = std::make_unique<Staged>();
  if (part.piece_names.size() != part.piece_ids.size())
    return abandon(refuse(ApplyError::BadShape, "snapshot: pieces and their tetrahedra differ in number"));
  for (std::size_t i = 0; i < part.piece_ids.size(); ++i)
    staged_->state.names[part.piece_ids[i]] = part.piece_names[i];
  staged_->begin = part;
  staged_->begin.piece_ids = staged_->begin.piece_names = {};
  staged_->state.revision = part.revision;
  return {};
}

ApplyResult Replica::chunk(const SnapshotChunk& part) {
  if (!staged_) return refuse(ApplyError::OutOfOrder, "snapshot chunk without a snapshot");
  Staged& s = *staged_;
  if (ApplyResult r = check_turn(s.begin, s.chunks_done, part); !r) return abandon(std::move(r));
  State& state = s.state;
  const std::size_t have = state.positions.size() / 3;
  if (part.positions.size() % 3 != 0 || (!part.positions.empty() && part.first_vertex != have)) {
    return abandon(refuse(
        ApplyError::OutOfOrder,
        "snapshot chunk with vertices from " + number(part.first_vertex) + ", expected is " + number(have)));
  }
  if (have + part.positions.size() / 3 > s.begin.vertex_count) {
    return abandon(refuse(ApplyError::BadShape,
                          "snapshot with more than its " + number(s.begin.vertex_count) + " vertices"));
  }
  const std::size_t rest = state.rest.size() + part.rest_positions.size();
  if (rest != 0 && rest != state.positions.size() + part.positions.size()) {
    return abandon(
        refuse(ApplyError::BadShape, "snapshot chunk with rest positions of some of its vertices"));
  }
  state.positions.insert(state.positions.end(), part.positions.begin(), part.positions.end());
  state.rest.insert(state.rest.end(), part.rest_positions.begin(), part.rest_positions.end());
  const std::uint64_t more = hash_vertices(have, part.positions);
  state.vertices_hash ^= more;
  state.hash ^= more;
  if (ApplyResult r = add(state, s.next_tet, s.begin.vertex_count, part.tets); !r) {
    return abandon(std::move(r));
  }
  if (state.live_tets > s.begin.tet_count) {
    return abandon(refuse(ApplyError::BadShape,
                          "snapshot with more than its " + number(s.begin.tet_count) + " tetrahedra"));
  }
  ++s.chunks_done;
  return {};
}

ApplyResult Replica::end(const SnapshotEnd& part) {
  if (!staged_) return refuse(ApplyError::OutOfOrder, "end of a snapshot that has not begun");
  const Staged& s = *staged_;
  if (ApplyResult r = check_turn(s.begin, s.chunks_done, part); !r) return abandon(std::move(r));
  if (s.state.positions.size() / 3 != s.begin.vertex_count || s.state.live_tets != s.begin.tet_count) {
    return abandon(refuse(ApplyError::BadShape,
                          "snapshot with " + number(s.state.positions.size() / 3) + " vertices and " +
                              number(s.state.live_tets) + " tetrahedra, announced were " +
                              number(s.begin.vertex_count) + " and " + number(s.begin.tet_count)));
  }
  if (s.state.hash != part.state_hash) {
    return abandon(refuse(ApplyError::HashMismatch, "snapshot of revision " + number(part.revision) +
                                                        " has hash " + hex(s.state.hash) +
                                                        ", announced was " + hex(part.state_hash)));
  }
  for (const auto& [id, tet] : s.state.names) {
    if (tet < s.state.tets.size() && s.state.tets[tet][0] != kNoId) continue;
    return abandon(refuse(ApplyError::BadIndex, "snapshot: piece " + number(id) + " with tetrahedron " +
                                                    number(tet) + ", which does not exist"));
  }
  state_ = std::move(staged_->state);
  staged_.reset();
  return {};
}

// ---- Deltas ----

ApplyResult Replica::check(const Delta& d) const {
  if (d.base_revision != state_.revision || d.revision <= d.base_revision) {
    return refuse(ApplyError::WrongBase, "delta from revision " + number(d.base_revision) + " to " +
                                             number(d.revision) + ", this state is at " +
                                             number(state_.revision));
  }
  const std::size_t added = d.provenance_t.size();
  if (d.moved_positions.size() != 3 * d.moved_ids.size() || d.added_positions.size() != 3 * added ||
      d.provenance_a.size() != added || d.provenance_b.size() != added || !fits(d.tets) ||
      d.blend_vertices.size() != 4 * d.blend_ids.size() || d.blend_weights.size() != 4 * d.blend_ids.size() ||
      d.piece_names.size() != d.piece_ids.size()) {
    return refuse(ApplyError::BadShape, "delta: arrays of different lengths");
  }
  const std::uint32_t vertices = vertex_count();
  if (added > max_vertices_ - vertices) {
    return refuse(ApplyError::LimitReached,
                  number(vertices + added) + " vertices, the limit is " + number(max_vertices_));
  }
  const auto vertices_after = static_cast<std::uint32_t>(vertices + added);
  if ((added > 0 && d.first_added != vertices) || d.vertex_count != vertices_after) {
    return refuse(ApplyError::BadIndex, "delta that adds vertices " + number(d.first_added) +
                                            " and on to make " + number(d.vertex_count) +
                                            ": this state has " + number(vertices) + " and gets " +
                                            number(added));
  }
  if (ApplyResult r = check_ascending("moved vertex", d.moved_ids); !r) return r;
  if (!d.moved_ids.empty() && d.moved_ids.back() >= vertices) {
    return refuse(ApplyError::BadIndex, "moved vertex " + number(d.moved_ids.back()) +
                                            ", accepted are those below " + number(vertices));
  }
  if (const std::string error = provenance_error(d, vertices); !error.empty())
    return refuse(ApplyError::BadIndex, "delta: " + error);

  if (d.rest_positions.size() != 3 * d.rest_ids.size()) {
    return refuse(ApplyError::BadShape, "delta: rest positions, not three for each vertex");
  }
  if (ApplyResult r = check_ascending("rest vertex", d.rest_ids); !r) return r;
  if (!d.rest_ids.empty() && d.rest_ids.back() >= vertices_after) {
    return refuse(ApplyError::BadIndex, "rest position of vertex " + number(d.rest_ids.back()) +
                                            ", accepted are those below " + number(vertices_after));
  }

  if (ApplyResult r = check_ascending("tetrahedron", d.tets.ids); !r) return r;
  if (d.first_new_tet < tet_slots()) {
    return refuse(ApplyError::BadIndex, "delta with new tetrahedra from " + number(d.first_new_tet) +
                                            ", this state has used ids up to " + number(tet_slots()));
  }
  if (!d.tets.ids.empty() && d.tets.ids.back() >= max_tets_) {
    return refuse(ApplyError::LimitReached,
                  "tetrahedron " + number(d.tets.ids.back()) + ", the limit is " + number(max_tets_));
  }
  std::size_t created = 0;
  for (std::size_t i = 0; i < d.tets.ids.size(); ++i) {
    if (d.tets.ids[i] >= d.first_new_tet) {
      ++created;
    } else if (!alive(d.tets.ids[i])) {
      return refuse(ApplyError::BadIndex, "changed tetrahedron " + number(d.tets.ids[i]) + " does not exist");
    }
    if (ApplyResult r = check_tet(d.tets, i, vertices_after); !r) return r;
  }
  if (!d.tet_elders.empty() && d.tet_elders.size() != created)
    return refuse(ApplyError::BadShape, "delta with elders of " + number(d.tet_elders.size()) +
                                            " tetrahedra, of " + number(created) + " new ones");
  for (const std::uint32_t t : d.tet_elders) {
    if (!alive(t)) return refuse(ApplyError::BadIndex, "elder " + number(t) + " does not exist");
  }
  if (ApplyResult r = check_ascending("removed tetrahedron", d.removed_tets); !r) return r;
  for (const std::uint32_t t : d.removed_tets) {
    if (!alive(t) || std::binary_search(d.tets.ids.begin(), d.tets.ids.end(), t)) {
      return refuse(ApplyError::BadIndex,
                    "removed tetrahedron " + number(t) + " does not exist, or also changes");
    }
  }
  if (d.live_tets != state_.live_tets + created - d.removed_tets.size()) {
    return refuse(ApplyError::BadShape, "delta to " + number(d.live_tets) + " tetrahedra makes " +
                                            number(state_.live_tets + created - d.removed_tets.size()));
  }

  // The boundary mask of t after the delta; 0 where there is no such tetrahedron.
  const auto mask_after = [&](std::uint32_t t) -> std::uint8_t {
    const auto entry = std::lower_bound(d.tets.ids.begin(), d.tets.ids.end(), t);
    if (entry != d.tets.ids.end() && *entry == t) {
      return d.tets.boundary_masks[static_cast<std::size_t>(entry - d.tets.ids.begin())];
    }
    const bool lives = alive(t) && !std::binary_search(d.removed_tets.begin(), d.removed_tets.end(), t);
    return lives ? state_.boundary_masks[t] : std::uint8_t{0};
  };
  for (const std::uint32_t h : d.boundary_upserted) {
    if (!(mask_after(h >> 2) >> (h & 3) & 1)) {
      return refuse(ApplyError::BadIndex, "boundary face " + number(h) + " is not on the boundary");
    }
  }
  for (const std::uint32_t h : d.boundary_removed) {
    if (mask_after(h >> 2) >> (h & 3) & 1) {
      return refuse(ApplyError::BadIndex, "removed boundary face " + number(h) + " is on the boundary");
    }
  }
  for (const std::uint32_t t : d.piece_names) {
    const bool removed = std::binary_search(d.removed_tets.begin(), d.removed_tets.end(), t);
    if (removed || (!alive(t) && !std::binary_search(d.tets.ids.begin(), d.tets.ids.end(), t))) {
      return refuse(ApplyError::BadIndex, "piece with tetrahedron " + number(t) + ", which does not exist");
    }
  }
  return {};
}

std::uint64_t Replica::hash_of_moves(const Delta& d) const {
  const std::span<const std::uint32_t> moved = d.moved_ids;
  const std::uint64_t now = hash_vertices(
      moved.size(), [&](std::size_t i) { return moved[i]; },
      [&](std::size_t i) { return &d.moved_positions[3 * i]; });
  const std::span<const double> positions = state_.positions;
  if (2 * moved.size() < vertex_count()) {
    return now ^ hash_vertices(
                     moved.size(), [&](std::size_t i) { return moved[i]; },
                     [&](std::size_t i) { return &positions[3 * std::size_t{moved[i]}]; });
  }
  // A step of a simulation moves nearly all of them, so it is quicker to hash those that stay.
  std::uint64_t before = state_.vertices_hash;
  std::size_t next = 0;
  const auto leave_out = [&](std::size_t end) {
    before ^= hash_vertices(next, positions.subspan(3 * next, 3 * (end - next)));
  };
  for (const std::uint32_t v : moved) {
    if (v > next) leave_out(v);
    next = v + std::size_t{1};
  }
  leave_out(vertex_count());
  return now ^ before;
}

std::pair<std::uint64_t, std::uint64_t> Replica::hashes_after(const Delta& d) const {
  std::uint64_t tets = 0;
  const auto old_tet = [&](std::uint32_t t) {
    return tet_hash(t, vertices(t).data(), region(t), cut_mask(t));
  };
  for (const std::uint32_t t : d.removed_tets) tets ^= old_tet(t);
  for (std::size_t i = 0; i < d.tets.ids.size(); ++i) {
    if (alive(d.tets.ids[i])) tets ^= old_tet(d.tets.ids[i]);
    tets ^= hash_entry(d.tets, i);
  }
  const std::uint64_t change = hash_of_moves(d) ^ hash_vertices(vertex_count(), d.added_positions);
  return {state_.hash ^ tets ^ change, state_.vertices_hash ^ change};
}

// Before the first deformation the positions are the rest positions.
void Replica::apply_rest(const Delta& d) {
  std::vector<double>& rest = state_.rest;
  if (rest.empty()) rest.assign(state_.positions.begin(), state_.positions.end());
  for (std::size_t i = 0; i < d.provenance_t.size(); ++i) {
    const std::size_t a = 3 * std::size_t{d.provenance_a[i]}, b = 3 * std::size_t{d.provenance_b[i]};
    for (std::size_t k = 0; k < 3; ++k)
      rest.push_back(rest[a + k] + d.provenance_t[i] * (rest[b + k] - rest[a + k]));
  }
  for (std::size_t i = 0; i < d.rest_ids.size(); ++i) {
    std::copy_n(&d.rest_positions[3 * i], 3, &rest[3 * std::size_t{d.rest_ids[i]}]);
  }
}

ApplyResult Replica::apply(const Delta& d) {
  if (ApplyResult r = check(d); !r) return r;
  const auto [hash, vertices_hash] = hashes_after(d);
  if (hash != d.state_hash) {
    return refuse(ApplyError::HashMismatch, "revision " + number(d.revision) + " has hash " + hex(hash) +
                                                ", announced was " + hex(d.state_hash));
  }
  // Nothing below can fail but an allocation, and those come first: a delta that memory has no room for
  // changes nothing that anyone can see.
  State& s = state_;
  const std::size_t slots = d.tets.ids.empty()
                                ? s.tets.size()
                                : std::max<std::size_t>(s.tets.size(), d.tets.ids.back() + std::size_t{1});
  const std::size_t numbers = s.positions.size() + d.added_positions.size();
  if (numbers > s.positions.capacity()) s.positions.reserve(std::max(numbers, 2 * s.positions.capacity()));
  const bool deforms =
      std::any_of(d.steps.begin(), d.steps.end(), [](const Step& step) { return step.stroke == 0; });
  if (deforms || deformed() || !d.rest_ids.empty()) {
    if (numbers > s.rest.capacity()) s.rest.reserve(std::max(numbers, 2 * s.rest.capacity()));
    apply_rest(d);
  }
  s.resize_tets(slots);

  for (std::size_t i = 0; i < d.moved_ids.size(); ++i) {
    std::copy_n(&d.moved_positions[3 * i], 3, &s.positions[3 * std::size_t{d.moved_ids[i]}]);
  }
  s.positions.insert(s.positions.end(), d.added_positions.begin(), d.added_positions.end());
  for (const std::uint32_t t : d.removed_tets) {
    s.boundary_faces -= static_cast<std::uint32_t>(std::popcount(s.boundary_masks[t]));
    s.tets[t].fill(kNoId);
    if (!s.regions.empty()) s.regions[t] = 0;
    s.cut_masks[t] = s.boundary_masks[t] = 0;
  }
  for (std::size_t i = 0; i < d.tets.ids.size(); ++i) {
    s.boundary_faces -= static_cast<std::uint32_t>(std::popcount(s.boundary_masks[d.tets.ids[i]]));
    s.set_tet(d.tets, i);
  }
  for (std::size_t p = 0; p < d.piece_ids.size(); ++p) s.names[d.piece_ids[p]] = d.piece_names[p];
  if (!d.tets.ids.empty() || !d.removed_tets.empty() || !d.piece_ids.empty()) s.pieces_known = false;
  s.live_tets = d.live_tets;
  s.hash = hash;
  s.vertices_hash = vertices_hash;
  s.revision = d.revision;
  return {};
}

// ---- Writing ----

std::vector<std::byte> Replica::canonical_bytes() const {
  std::vector<std::byte> out;
  out.reserve(32 + state_.positions.size() * 8 + std::size_t{live_tets()} * 32);
  const auto put = [&](const auto& value) {
    const auto* bytes = reinterpret_cast<const std::byte*>(&value);
    out.insert(out.end(), bytes, bytes + sizeof value);
  };
  put(revision());
  put(state_hash());
  put(vertex_count());
  put(live_tets());
  for (const double x : state_.positions) put(x);
  for_each_tet([&](std::uint32_t t) {
    put(t);
    for (const std::uint32_t v : vertices(t)) put(v);
    put(region(t));
    put(piece(t));
    put(static_cast<std::uint32_t>(cut_mask(t) | boundary_mask(t) << 8));
  });
  return out;
}

}  // namespace incise::protocol
