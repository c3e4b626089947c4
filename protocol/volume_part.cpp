#include "protocol/volume_part.hpp"

#include <algorithm>
#include <cstring>
#include <map>
#include <string>

#include "protocol/apply_checks.hpp"
#include "protocol/state_hash.hpp"

namespace incise::protocol {
namespace {

std::uint64_t hash_of(std::uint32_t id, const VolumePart::Tet& t) {
  return tet_hash(id, t.vertices.data(), t.region, t.cut_mask);
}

std::uint64_t hash_of(std::uint32_t id, const Vec3& p) {
  return vertex_hash(id, p.x, p.y, p.z);
}

Vec3 position_at(std::span<const double> positions, std::size_t i) {
  return {positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]};
}

// As the hash sees them: 0 and -0 are two.
bool same_bits(const Vec3& a, const Vec3& b) {
  return std::memcmp(&a, &b, sizeof a) == 0;
}

VolumePart::Tet entry(const TetArrays& t, std::size_t i) {
  VolumePart::Tet tet;
  std::copy_n(&t.vertices[4 * i], 4, tet.vertices.begin());
  tet.region = t.regions[i];
  tet.cut_mask = t.cut_masks[i];
  tet.boundary_mask = t.boundary_masks[i];
  return tet;
}

VolumePart::Tet tet_of(const Replica& mesh, std::uint32_t t) {
  return {mesh.vertices(t), mesh.region(t), mesh.cut_mask(t), mesh.boundary_mask(t), mesh.piece(t)};
}

std::array<Vec3, 4> corners(const Replica& mesh, std::uint32_t t) {
  const auto& v = mesh.vertices(t);
  return {mesh.position(v[0]), mesh.position(v[1]), mesh.position(v[2]), mesh.position(v[3])};
}

void append(OwnedDelta& out, std::uint32_t id, const VolumePart::Tet& t) {
  out.tet_ids.push_back(id);
  out.tet_vertices.insert(out.tet_vertices.end(), t.vertices.begin(), t.vertices.end());
  out.tet_regions.push_back(t.region);
  out.tet_cut_masks.push_back(t.cut_mask);
  out.tet_boundary_masks.push_back(t.boundary_mask);
}

void append(std::vector<double>& out, const Vec3& p) {
  out.insert(out.end(), {p.x, p.y, p.z});
}

// The half-faces that enter, leave or change on the boundary when a tetrahedron of the part changes, enters (no `old`) or
// leaves (no `now`).
void append_faces(OwnedDelta& out, std::uint32_t id, const VolumePart::Tet* old, const VolumePart::Tet* now) {
  for (std::uint32_t f = 0; f < 4; ++f) {
    const bool was = old && (old->boundary_mask >> f & 1);
    const bool is = now && (now->boundary_mask >> f & 1);
    if (was && !is) out.boundary_removed.push_back(4 * id + f);
    if (!is) continue;
    bool same = was && (old->cut_mask >> f & 1) == (now->cut_mask >> f & 1);
    for (const int corner : kFaceVertices[f]) same = same && old->vertices[corner] == now->vertices[corner];
    if (!same) out.boundary_upserted.push_back(4 * id + f);
  }
}

}  // namespace

// ---- Receiving ----

ApplyResult VolumePart::State::check(const Change& c, std::uint64_t& hash_after) const {
  const std::size_t n = c.tets.ids.size();
  if (c.set_positions.size() != 3 * c.set_ids.size() || c.added_positions.size() != 3 * c.added_ids.size() ||
      c.tets.vertices.size() != 4 * n || c.tets.regions.size() != n || c.tets.cut_masks.size() != n ||
      c.tets.boundary_masks.size() != n) {
    return refuse(ApplyError::BadShape, "part of the volume: arrays of different lengths");
  }
  for (const auto ids : {c.set_ids, c.added_ids, c.removed_vertices, c.tets.ids, c.removed_tets})
    if (!ascending(ids)) return refuse(ApplyError::BadIndex, "part of the volume: ids that do not ascend");

  hash_after = hash;
  for (std::size_t i = 0; i < c.set_ids.size(); ++i) {
    if (const Vertex* old = vertices.find(c.set_ids[i])) hash_after ^= hash_of(c.set_ids[i], old->position);
    hash_after ^= hash_of(c.set_ids[i], position_at(c.set_positions, i));
  }
  for (std::size_t i = 0; i < c.added_ids.size(); ++i) {
    if (vertices.contains(c.added_ids[i]) || contains(c.set_ids, c.added_ids[i]))
      return refuse(ApplyError::BadIndex, "added vertex " + number(c.added_ids[i]) + " exists");
    hash_after ^= hash_of(c.added_ids[i], position_at(c.added_positions, i));
  }
  MoreUses more_uses;
  const auto take_out = [&](std::uint32_t id) {
    const Tet* old = tets.find(id);
    if (old == nullptr) return;
    hash_after ^= hash_of(id, *old);
    more_uses.add(old->vertices, -1);
  };
  for (const std::uint32_t id : c.removed_tets) {
    if (contains(c.tets.ids, id))
      return refuse(ApplyError::BadIndex, "tetrahedron " + number(id) + " removed and set");
    take_out(id);
  }
  for (std::size_t i = 0; i < n; ++i) {
    const Tet tet = entry(c.tets, i);
    const auto wrong = [&](const std::string& what) {
      return refuse(ApplyError::BadIndex, "tetrahedron " + number(c.tets.ids[i]) + ": " + what);
    };
    const auto& v = tet.vertices;
    if (v[0] == v[1] || v[0] == v[2] || v[0] == v[3] || v[1] == v[2] || v[1] == v[3] || v[2] == v[3])
      return wrong("a vertex twice");
    if ((tet.cut_mask | tet.boundary_mask) > 15) return wrong("a mask bit above 3");
    for (const std::uint32_t vertex : v) {
      const bool known =
          contains(c.set_ids, vertex) || contains(c.added_ids, vertex) || vertices.contains(vertex);
      if (!known || contains(c.removed_vertices, vertex))
        return wrong("vertex " + number(vertex) + " is not in the part");
    }
    more_uses.add(v, 1);
    take_out(c.tets.ids[i]);
    hash_after ^= hash_of(c.tets.ids[i], tet);
  }
  if (!c.removed_vertices.empty()) more_uses.sorted();
  for (const std::uint32_t id : c.removed_vertices) {
    if (contains(c.set_ids, id) || contains(c.added_ids, id))
      return refuse(ApplyError::BadIndex, "vertex " + number(id) + " removed and set");
    const Vertex* old = vertices.find(id);
    if (old == nullptr) continue;
    if (old->uses + more_uses.more(id) != 0)
      return refuse(ApplyError::BadIndex, "removed vertex " + number(id) + " still has tetrahedra");
    hash_after ^= hash_of(id, old->position);
  }
  return {};
}

void VolumePart::State::apply(const Change& c, std::uint64_t hash_after) {
  const auto use = [&](const Tet& tet, std::uint32_t sign) {
    for (const std::uint32_t v : tet.vertices) vertices[v].uses += sign;
  };
  constexpr auto kLess = static_cast<std::uint32_t>(-1);
  for (std::size_t i = 0; i < c.set_ids.size(); ++i)
    vertices[c.set_ids[i]].position = position_at(c.set_positions, i);
  for (std::size_t i = 0; i < c.added_ids.size(); ++i)
    vertices[c.added_ids[i]].position = position_at(c.added_positions, i);
  for (std::size_t i = 0; i < c.tets.ids.size(); ++i) {
    Tet now = entry(c.tets, i);
    if (const Tet* old = tets.find(c.tets.ids[i])) {
      use(*old, kLess);
      now.piece = old->piece;
    }
    tets[c.tets.ids[i]] = now;
    use(now, 1);
  }
  for (const std::uint32_t id : c.removed_tets) {
    const Tet* old = tets.find(id);
    if (old == nullptr) continue;
    use(*old, kLess);
    tets.erase(id);
  }
  for (const std::uint32_t id : c.removed_vertices) vertices.erase(id);
  hash = hash_after;
}

void VolumePart::State::set_pieces(const Delta& d) {
  std::size_t next = 0;
  for (std::size_t p = 0; p < d.piece_ids.size(); ++p)
    for (std::uint32_t k = 0; k < d.piece_sizes[p]; ++k) tets[d.piece_tets[next++]].piece = d.piece_ids[p];
}

VolumePart::Change VolumePart::change_of(const Delta& d) {
  return {d.moved_ids,       d.added_ids, d.removed_vertices, d.moved_positions,
          d.added_positions, d.tets,      d.removed_tets};
}

ApplyResult VolumePart::check_pieces(const Delta& d) const {
  std::uint64_t listed = 0;
  for (const std::uint32_t n : d.piece_sizes) listed += n;
  if (d.piece_sizes.size() != d.piece_ids.size() || listed != d.piece_tets.size())
    return refuse(ApplyError::BadShape, "delta: pieces that do not add up");
  for (const std::uint32_t t : d.piece_tets) {
    const bool stays = state_.tets.contains(t) && !contains(d.removed_tets, t);
    if (!stays && !contains(d.tets.ids, t))
      return refuse(ApplyError::BadIndex,
                    "piece with tetrahedron " + number(t) + ", which is not in the part");
  }
  return {};
}

ApplyResult VolumePart::apply(const Delta& d) {
  if (d.base_revision != state_.revision || d.revision <= d.base_revision) {
    return refuse(ApplyError::WrongBase, "delta from revision " + number(d.base_revision) + " to " +
                                             number(d.revision) + ", this state is at " +
                                             number(state_.revision));
  }
  const Change change = change_of(d);
  std::uint64_t hash = 0;
  if (ApplyResult r = state_.check(change, hash); !r) return r;
  if (ApplyResult r = check_pieces(d); !r) return r;
  if (hash != d.part_hash) {
    return refuse(ApplyError::HashMismatch, "part of revision " + number(d.revision) + " has another hash");
  }
  state_.apply(change, hash);
  state_.set_pieces(d);
  state_.revision = d.revision;
  return {};
}

ApplyResult VolumePart::abandon(ApplyResult why) {
  staged_.reset();
  return why;
}

ApplyResult VolumePart::begin(const SnapshotBegin& part) {
  staged_.reset();
  if (part.view != View::Volume || !part.box)
    return refuse(ApplyError::BadShape, "snapshot of something else than a part of the volume");
  staged_ = std::make_unique<Staged>();
  staged_->begin = part;
  staged_->state.revision = part.revision;
  return {};
}

ApplyResult VolumePart::chunk(const SnapshotChunk& part) {
  if (!staged_) return refuse(ApplyError::OutOfOrder, "snapshot chunk without a snapshot");
  Staged& s = *staged_;
  if (ApplyResult r = check_turn(s.begin, s.chunks_done, part); !r) return abandon(std::move(r));
  if (part.tet_pieces.size() != part.tets.ids.size())
    return abandon(refuse(ApplyError::BadShape, "snapshot chunk: tetrahedra without pieces"));
  const Change change{part.vertex_ids, {}, {}, part.positions, {}, part.tets, {}};
  std::uint64_t hash = 0;
  if (ApplyResult r = s.state.check(change, hash); !r) return abandon(std::move(r));
  s.state.apply(change, hash);
  for (std::size_t i = 0; i < part.tets.ids.size(); ++i)
    s.state.tets[part.tets.ids[i]].piece = part.tet_pieces[i];
  ++s.chunks_done;
  return {};
}

ApplyResult VolumePart::end(const SnapshotEnd& part) {
  if (!staged_) return refuse(ApplyError::OutOfOrder, "end of a snapshot that has not begun");
  const Staged& s = *staged_;
  if (ApplyResult r = check_turn(s.begin, s.chunks_done, part); !r) return abandon(std::move(r));
  if (s.state.vertices.size() != s.begin.vertex_count || s.state.tets.size() != s.begin.tet_count) {
    return abandon(
        refuse(ApplyError::BadShape, "snapshot with " + number(s.state.vertices.size()) + " vertices and " +
                                         number(s.state.tets.size()) + " tetrahedra, announced were " +
                                         number(s.begin.vertex_count) + " and " + number(s.begin.tet_count)));
  }
  if (s.state.hash != part.part_hash) {
    return abandon(refuse(ApplyError::HashMismatch,
                          "part in the snapshot of revision " + number(part.revision) + " has another hash"));
  }
  state_ = std::move(staged_->state);
  staged_.reset();
  return {};
}

std::uint64_t VolumePart::compute_part_hash() const {
  std::uint64_t hash = 0;
  for (const auto& [id, vertex] : vertices()) hash ^= hash_of(id, vertex.position);
  for (const auto& [id, tet] : tets()) hash ^= hash_of(id, tet);
  return hash;
}

std::vector<std::byte> VolumePart::canonical_bytes() const {
  std::vector<std::byte> out;
  out.reserve(24 + vertices().size() * 28 + tets().size() * 32);
  const auto put = [&](const auto& value) {
    const auto* bytes = reinterpret_cast<const std::byte*>(&value);
    out.insert(out.end(), bytes, bytes + sizeof value);
  };
  put(revision());
  put(part_hash());
  put(static_cast<std::uint32_t>(vertices().size()));
  put(static_cast<std::uint32_t>(tets().size()));
  for (const auto& [id, vertex] : vertices()) {
    put(id);
    put(vertex.position.x);
    put(vertex.position.y);
    put(vertex.position.z);
  }
  for (const auto& [id, tet] : tets()) {
    put(id);
    for (const std::uint32_t v : tet.vertices) put(v);
    put(tet.region);
    put(tet.piece);
    put(static_cast<std::uint32_t>(tet.cut_mask | tet.boundary_mask << 8));
  }
  return out;
}

// ---- The server's side ----

void VolumePart::load_part(const Replica& whole, const Box& box) {
  state_ = {};
  staged_.reset();
  shell_ = {};
  std::vector<std::uint32_t> used;
  whole.for_each_tet([&](std::uint32_t t) {
    if (!meets(box, corners(whole, t))) return;
    const Tet tet = tet_of(whole, t);
    state_.tets[t] = tet;
    state_.hash ^= hash_of(t, tet);
    used.insert(used.end(), tet.vertices.begin(), tet.vertices.end());
  });
  std::sort(used.begin(), used.end());
  for (auto at = used.begin(); at != used.end();) {
    const auto next = std::upper_bound(at, used.end(), *at);
    const Vertex vertex{whole.position(*at), static_cast<std::uint32_t>(next - at)};
    state_.vertices[*at] = vertex;
    state_.hash ^= hash_of(*at, vertex.position);
    at = next;
  }
  state_.revision = whole.revision();
}

// The tetrahedra that the change names, and those that it may have moved into or out of the box.
std::vector<std::uint32_t> VolumePart::tets_to_look_at(const Replica& whole, const TetIndex& index,
                                                       const MeshChange& change, const Box& box) {
  std::vector<std::uint32_t> out = change.tets;
  // A vertex that moves may take otherwise unchanged tetrahedra into the box, or out of it.
  for (const std::uint32_t v : change.cut_moved) index.append_tets(v, out);
  sort_unique(out);
  for (const std::uint32_t t : out)
    if (whole.alive(t)) shell_.add(t, corners(whole, t));
  looked_at_ = out.size();
  if (!change.deformed) return out;
  const auto look = [&](std::uint32_t t, std::span<const Vec3> at) {
    if (meets(box, at) != state_.tets.contains(t)) out.push_back(t);
    ++looked_at_;
  };
  if (shell_.covers(change.travel_m)) {
    for (const std::uint32_t t : shell_.ids())
      if (whole.alive(t)) look(t, corners(whole, t));
  } else {
    shell_.begin(box, change.travel_m);
    whole.for_each_tet([&](std::uint32_t t) {
      const std::array<Vec3, 4> at = corners(whole, t);
      look(t, at);
      shell_.add(t, at);
    });
  }
  sort_unique(out);
  return out;
}

// Adds vertices that may have moved although none of their tetrahedra has changed.
void VolumePart::add_moved(const Replica& whole, const MeshChange& change, MoreUses& out) {
  if (!change.deformed) {
    for (const std::uint32_t v : change.cut_moved) out.add(v);
    return;
  }
  for (const auto& [v, vertex] : vertices())
    if (!same_bits(vertex.position, whole.position(v))) out.add(v);
  looked_at_ += vertices().size();
}

OwnedDelta VolumePart::follow_part(const Replica& whole, const TetIndex& index, const MeshChange& change,
                                   const Box& box) {
  OwnedDelta out;
  out.base_revision = change.base_revision;
  out.revision = change.revision;
  out.steps = change.steps;
  out.first_added = change.first_added;
  out.vertex_count = change.vertex_count;
  out.live_tets = change.live_tets;
  out.state_hash = change.state_hash;
  out.first_new_tet = change.first_new_tet;
  MoreUses more_uses;
  std::map<std::uint32_t, std::vector<std::uint32_t>> pieces;
  for (const std::uint32_t id : tets_to_look_at(whole, index, change, box)) {
    const Tet* const old = state_.tets.find(id);
    const bool inside = whole.alive(id) && meets(box, corners(whole, id));
    if (old && !inside) {
      out.removed_tets.push_back(id);
      append_faces(out, id, old, nullptr);
      more_uses.add(old->vertices, -1);
    }
    if (!inside) continue;
    const Tet now = tet_of(whole, id);
    if ((old ? old->piece : 0) != now.piece) pieces[now.piece].push_back(id);
    Tet in_its_old_piece = now;
    if (old) in_its_old_piece.piece = old->piece;
    if (old && *old == in_its_old_piece) continue;
    append(out, id, now);
    append_faces(out, id, old, &now);
    if (old) more_uses.add(old->vertices, -1);
    more_uses.add(now.vertices, 1);
  }
  add_moved(whole, change, more_uses);
  for (const auto& [v, more] : more_uses.sorted()) {
    const Vertex* old = state_.vertices.find(v);
    if ((old ? old->uses : 0) + std::int64_t{more} == 0) {
      if (old) out.removed_vertices.push_back(v);
      continue;
    }
    const Vec3 position = whole.position(v);
    if (old && same_bits(old->position, position)) continue;
    if (v < out.first_added) {
      out.moved_ids.push_back(v);
      append(out.moved_positions, position);
      continue;
    }
    const std::size_t i = v - out.first_added;
    out.added_ids.push_back(v);
    append(out.added_positions, position);
    out.provenance_a.push_back(change.provenance_a[i]);
    out.provenance_b.push_back(change.provenance_b[i]);
    out.provenance_t.push_back(change.provenance_t[i]);
  }
  for (const auto& [piece, members] : pieces) {
    out.piece_ids.push_back(piece);
    out.piece_sizes.push_back(static_cast<std::uint32_t>(members.size()));
    out.piece_tets.insert(out.piece_tets.end(), members.begin(), members.end());
  }
  const Delta sent = out.view();
  state_.check(change_of(sent), out.part_hash);
  state_.apply(change_of(sent), out.part_hash);
  state_.set_pieces(sent);
  state_.revision = whole.revision();
  return out;
}

VolumePartWriter::VolumePartWriter(const VolumePart& part, const Box& box, SnapshotCause cause,
                                   std::size_t chunk_elements)
    : part_(part),
      chunk_elements_(std::max<std::size_t>(1, chunk_elements)),
      next_vertex_(part.vertices().begin()),
      next_tet_(part.tets().begin()) {
  const auto chunks_of = [&](std::size_t n) { return (n + chunk_elements_ - 1) / chunk_elements_; };
  begin_.view = View::Volume;
  begin_.revision = part.revision();
  begin_.cause = cause;
  begin_.vertex_count = static_cast<std::uint32_t>(part.vertices().size());
  begin_.tet_count = static_cast<std::uint32_t>(part.tets().size());
  begin_.chunks =
      static_cast<std::uint32_t>(chunks_of(part.vertices().size()) + chunks_of(part.tets().size()));
  begin_.box = box;
}

bool VolumePartWriter::next() {
  if (chunks_made_ == begin_.chunks) return false;
  arrays_ = {};
  pieces_.clear();
  chunk_ = {};
  chunk_.index = chunks_made_++;
  if (next_vertex_ != part_.vertices().end()) {
    for (; next_vertex_ != part_.vertices().end() && arrays_.moved_ids.size() < chunk_elements_;
         ++next_vertex_) {
      const auto [id, vertex] = *next_vertex_;
      arrays_.moved_ids.push_back(id);
      append(arrays_.moved_positions, vertex.position);
    }
    chunk_.vertex_ids = arrays_.moved_ids;
    chunk_.positions = arrays_.moved_positions;
    return true;
  }
  for (; next_tet_ != part_.tets().end() && arrays_.tet_ids.size() < chunk_elements_; ++next_tet_) {
    const auto [id, tet] = *next_tet_;
    append(arrays_, id, tet);
    pieces_.push_back(tet.piece);
  }
  chunk_.tets = arrays_.view().tets;
  chunk_.tet_pieces = pieces_;
  return true;
}

}  // namespace incise::protocol
