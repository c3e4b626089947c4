#include "protocol/surface.hpp"

#include <algorithm>
#include <cstring>
#include <functional>
#include <string>

#include "protocol/apply_checks.hpp"
#include "protocol/state_hash.hpp"
#include "protocol/vertex_hashes.hpp"

namespace incise::protocol {
namespace {

SurfaceReplica::Triangle entry(const TriangleArrays& t, std::size_t i) {
  return {{t.vertices[3 * i], t.vertices[3 * i + 1], t.vertices[3 * i + 2]},
          t.flags[i],
          t.pieces[i],
          t.regions[i],
          t.origins.empty() ? kNoId : t.origins[i]};
}

std::uint64_t hash_of(std::uint32_t id, const SurfaceReplica::Triangle& t) {
  return triangle_hash(id, t.vertices.data(), t.flags);
}

std::uint64_t vertices_hash(std::span<const std::uint32_t> ids, std::span<const float> positions) {
  return SurfaceVertexHashes::combined(ids.size(), ids.data(), positions.data());
}

// As the hash sees them: 0 and -0 are two.
bool same_bits(const std::array<float, 3>& a, const std::array<float, 3>& b) {
  return std::memcmp(a.data(), b.data(), sizeof a) == 0;
}

void append(SurfaceChange& out, std::uint32_t id, const SurfaceReplica::Triangle& t) {
  out.triangle_ids.push_back(id);
  out.triangle_vertices.insert(out.triangle_vertices.end(), t.vertices.begin(), t.vertices.end());
  out.triangle_flags.push_back(t.flags);
  out.triangle_pieces.push_back(t.piece);
  out.triangle_regions.push_back(t.region);
  // All have one entry, or none: the array begins with the first origin.
  if (t.origin != kNoId || !out.triangle_origins.empty()) {
    out.triangle_origins.resize(out.triangle_ids.size() - 1, kNoId);
    out.triangle_origins.push_back(t.origin);
  }
}

void append(SurfaceChange& out, std::uint32_t id, const std::array<float, 3>& position) {
  out.vertex_ids.push_back(id);
  out.vertex_positions.insert(out.vertex_positions.end(), position.begin(), position.end());
}

void append_rest(SurfaceChange& out, std::uint32_t id, const std::array<float, 3>& rest) {
  out.rest_ids.push_back(id);
  out.rest_positions.insert(out.rest_positions.end(), rest.begin(), rest.end());
}

std::array<float, 3> position_of(const Replica& mesh, std::uint32_t v) {
  const Vec3 p = mesh.position(v);
  return {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)};
}

Vec3 exact_rest_of(const Replica& mesh, std::uint32_t v) {
  const double* p = &mesh.rest_positions()[3 * std::size_t{v}];
  return {p[0], p[1], p[2]};
}

std::array<float, 3> rest_of(const Replica& mesh, std::uint32_t v) {
  const Vec3 p = exact_rest_of(mesh, v);
  return {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)};
}

// What changes on a surface where vertices move and nothing else happens: one walk along both, and `hash` follows. Named are places that
// the receiver does not have, and rest positions where it would not know them.
SurfaceChange moved_surface(const Replica& mesh, const IdMap<SurfaceReplica::Vertex>& vertices,
                            std::span<const std::uint32_t> moved, std::uint64_t& hash) {
  SurfaceChange out;
  std::vector<float> before;
  out.vertex_ids.reserve(vertices.size());
  out.vertex_positions.reserve(3 * vertices.size());
  before.reserve(3 * vertices.size());
  auto next = moved.begin();
  for (const auto& [v, old] : vertices) {
    while (next != moved.end() && *next < v) ++next;
    if (next == moved.end()) break;
    if (*next != v) continue;
    const std::array<float, 3> position = position_of(mesh, v);
    if (!same_bits(old.position, position)) {
      append(out, v, position);
      before.insert(before.end(), old.position.begin(), old.position.end());
    }
    if (!mesh.deformed()) continue;
    const std::array<float, 3> rest = rest_of(mesh, v);
    if (!same_bits(old.has_rest ? old.rest_at : position, rest)) append_rest(out, v, rest);
  }
  hash ^= vertices_hash(out.vertex_ids, before) ^ vertices_hash(out.vertex_ids, out.vertex_positions);
  return out;
}

}  // namespace

// ---- Receiving ----

ApplyResult SurfaceReplica::State::check(const Parts& parts, std::uint64_t& hash_after) const {
  const auto& [v, removed_vertices, t, removed_triangles, rest] = parts;
  const std::size_t n = t.ids.size();
  if (v.positions.size() != 3 * v.ids.size() || t.vertices.size() != 3 * n || t.flags.size() != n ||
      t.pieces.size() != n || t.regions.size() != n || (!t.origins.empty() && t.origins.size() != n) ||
      rest.positions.size() != 3 * rest.ids.size()) {
    return refuse(ApplyError::BadShape, "surface: arrays of different lengths");
  }
  if (!ascending(v.ids) || !ascending(removed_vertices) || !ascending(t.ids) ||
      !ascending(removed_triangles) || !ascending(rest.ids)) {
    return refuse(ApplyError::BadIndex, "surface: ids that do not ascend");
  }
  std::vector<std::uint32_t> had;
  std::vector<float> before;
  had.reserve(v.ids.size());
  before.reserve(v.positions.size());
  for (const std::uint32_t id : v.ids) {
    if (contains(removed_vertices, id)) {
      return refuse(ApplyError::BadIndex, "surface vertex " + number(id) + " removed and set");
    }
    if (const Vertex* old = vertices.find(id)) {
      had.push_back(id);
      before.insert(before.end(), old->position.begin(), old->position.end());
    }
  }
  hash_after = hash ^ vertices_hash(had, before) ^ vertices_hash(v.ids, v.positions);
  for (const std::uint32_t id : rest.ids) {
    if ((!contains(v.ids, id) && !vertices.contains(id)) || contains(removed_vertices, id))
      return refuse(ApplyError::BadIndex,
                    "rest position of vertex " + number(id) + ", which is not on the surface");
  }
  MoreUses more_uses;
  for (const std::uint32_t id : removed_triangles) {
    if (contains(t.ids, id))
      return refuse(ApplyError::BadIndex, "triangle " + number(id) + " removed and set");
    const Triangle* old = triangles.find(id);
    if (old == nullptr) continue;
    hash_after ^= hash_of(id, *old);
    more_uses.add(old->vertices, -1);
  }
  for (std::size_t i = 0; i < n; ++i) {
    const Triangle triangle = entry(t, i);
    const auto& [a, b, c] = triangle.vertices;
    if (a == b || b == c || c == a) {
      return refuse(ApplyError::BadIndex, "triangle " + number(t.ids[i]) + ": a vertex twice");
    }
    for (const std::uint32_t vertex : triangle.vertices) {
      const bool known = contains(v.ids, vertex) || vertices.contains(vertex);
      if (!known || contains(removed_vertices, vertex)) {
        return refuse(ApplyError::BadIndex, "triangle " + number(t.ids[i]) + ": vertex " + number(vertex) +
                                                " is not on the surface");
      }
    }
    more_uses.add(triangle.vertices, 1);
    if (const Triangle* old = triangles.find(t.ids[i])) {
      hash_after ^= hash_of(t.ids[i], *old);
      more_uses.add(old->vertices, -1);
    }
    hash_after ^= hash_of(t.ids[i], triangle);
  }
  if (removed_vertices.empty()) return {};
  more_uses.sorted();
  for (const std::uint32_t id : removed_vertices) {
    const Vertex* old = vertices.find(id);
    if (old == nullptr) continue;
    if (std::int64_t{old->uses} + more_uses.more(id) != 0) {
      return refuse(ApplyError::BadIndex, "removed surface vertex " + number(id) + " still has triangles");
    }
    hash_after ^= surface_vertex_hash(id, old->position.data());
  }
  return {};
}

void SurfaceReplica::State::apply(const Parts& parts, std::uint64_t hash_after) {
  const auto& [v, removed_vertices, t, removed_triangles, rest] = parts;
  const auto use = [&](const Triangle& triangle, std::uint32_t sign) {
    for (const std::uint32_t vertex : triangle.vertices) vertices[vertex].uses += sign;
  };
  constexpr auto kLess = static_cast<std::uint32_t>(-1);
  for (std::size_t i = 0; i < v.ids.size(); ++i)
    std::copy_n(&v.positions[3 * i], 3, vertices[v.ids[i]].position.begin());
  for (std::size_t i = 0; i < rest.ids.size(); ++i) {
    Vertex& vertex = vertices[rest.ids[i]];
    vertex.has_rest = true;
    std::copy_n(&rest.positions[3 * i], 3, vertex.rest_at.begin());
  }
  for (std::size_t i = 0; i < t.ids.size(); ++i) {
    if (const Triangle* old = triangles.find(t.ids[i])) use(*old, kLess);
    const Triangle now = entry(t, i);
    triangles[t.ids[i]] = now;
    use(now, 1);
  }
  for (const std::uint32_t id : removed_triangles) {
    const Triangle* old = triangles.find(id);
    if (old == nullptr) continue;
    use(*old, kLess);
    triangles.erase(id);
  }
  for (const std::uint32_t id : removed_vertices) vertices.erase(id);
  hash = hash_after;
}

ApplyResult SurfaceReplica::apply(const SurfaceDelta& d) {
  if (d.base_revision != state_.revision || d.revision <= d.base_revision) {
    return refuse(ApplyError::WrongBase, "surface delta from revision " + number(d.base_revision) + " to " +
                                             number(d.revision) + ", this state is at " +
                                             number(state_.revision));
  }
  std::uint64_t hash = 0;
  const Parts parts{d.vertices, d.removed_vertices, d.triangles, d.removed_triangles, d.rest};
  if (ApplyResult r = state_.check(parts, hash); !r) return r;
  if (hash != d.surface_hash) {
    return refuse(ApplyError::HashMismatch,
                  "surface of revision " + number(d.revision) + " has another hash");
  }
  state_.apply(parts, hash);
  state_.revision = d.revision;
  return {};
}

ApplyResult SurfaceReplica::abandon(ApplyResult why) {
  staged_.reset();
  return why;
}

ApplyResult SurfaceReplica::begin(const SnapshotBegin& part) {
  staged_.reset();
  if (part.view != View::Surface)
    return refuse(ApplyError::BadShape, "snapshot of another view than Surface");
  staged_ = std::make_unique<Staged>();
  staged_->begin = part;
  staged_->state.revision = part.revision;
  return {};
}

ApplyResult SurfaceReplica::chunk(const SnapshotChunk& part) {
  if (!staged_) return refuse(ApplyError::OutOfOrder, "snapshot chunk without a snapshot");
  Staged& s = *staged_;
  if (ApplyResult r = check_turn(s.begin, s.chunks_done, part); !r) return abandon(std::move(r));
  std::uint64_t hash = 0;
  const Parts parts{part.surface_vertices, {}, part.triangles, {}, part.surface_rest};
  if (ApplyResult r = s.state.check(parts, hash); !r) return abandon(r);
  s.state.apply(parts, hash);
  ++s.chunks_done;
  return {};
}

ApplyResult SurfaceReplica::end(const SnapshotEnd& part) {
  if (!staged_) return refuse(ApplyError::OutOfOrder, "end of a snapshot that has not begun");
  const Staged& s = *staged_;
  if (ApplyResult r = check_turn(s.begin, s.chunks_done, part); !r) return abandon(std::move(r));
  if (s.state.vertices.size() != s.begin.vertex_count || s.state.triangles.size() != s.begin.triangle_count) {
    return abandon(refuse(ApplyError::BadShape,
                          "snapshot with " + number(s.state.vertices.size()) + " vertices and " +
                              number(s.state.triangles.size()) + " triangles, announced were " +
                              number(s.begin.vertex_count) + " and " + number(s.begin.triangle_count)));
  }
  if (s.state.hash != part.surface_hash) {
    return abandon(refuse(ApplyError::HashMismatch,
                          "surface snapshot of revision " + number(part.revision) + " has another hash"));
  }
  state_ = std::move(staged_->state);
  staged_.reset();
  return {};
}

std::uint64_t SurfaceReplica::compute_surface_hash() const {
  std::uint64_t hash = 0;
  for (const auto& [id, vertex] : vertices()) hash ^= surface_vertex_hash(id, vertex.position.data());
  for (const auto& [id, triangle] : triangles()) hash ^= hash_of(id, triangle);
  return hash;
}

std::vector<std::byte> SurfaceReplica::canonical_bytes() const {
  std::vector<std::byte> out;
  out.reserve(24 + vertices().size() * 16 + triangles().size() * 28);
  const auto put = [&](const auto& value) {
    const auto* bytes = reinterpret_cast<const std::byte*>(&value);
    out.insert(out.end(), bytes, bytes + sizeof value);
  };
  put(revision());
  put(surface_hash());
  put(static_cast<std::uint32_t>(vertices().size()));
  put(static_cast<std::uint32_t>(triangles().size()));
  for (const auto& [id, vertex] : vertices()) {
    put(id);
    for (const float x : vertex.position) put(x);
  }
  for (const auto& [id, triangle] : triangles()) {
    put(id);
    for (const std::uint32_t v : triangle.vertices) put(v);
    put(triangle.region);
    put(triangle.piece);
    put(std::uint32_t{triangle.flags});
  }
  return out;
}

Corners SurfaceReplica::rest_corners(const Triangle& triangle) const {
  Corners out;
  for (std::size_t i = 0; i < 3; ++i) {
    const auto& p = state_.vertices.at(triangle.vertices[i]).rest();
    out[i] = {double{p[0]}, double{p[1]}, double{p[2]}};
  }
  return out;
}

// ---- The server's side ----

SurfaceReplica::Parts SurfaceReplica::parts_of(const SurfaceChange& change) {
  return {change.vertices(), change.removed_vertices, change.triangles(), change.removed_triangles,
          change.rest()};
}

SurfaceReplica::Triangle SurfaceReplica::triangle_of(const Replica& mesh, std::uint32_t tet, int face,
                                                     std::uint32_t origin_near) const {
  const bool cut = mesh.cut_mask(tet) >> face & 1;
  const auto vertices = mesh.face_vertices(tet, face);
  std::uint32_t origin = kNoId;
  if (origins_ && !cut) {
    origin = origins_->origin_of({exact_rest_of(mesh, vertices[0]), exact_rest_of(mesh, vertices[1]),
                                  exact_rest_of(mesh, vertices[2])},
                                 origin_near);
  }
  return {vertices, cut ? kTriangleCut : std::uint8_t{0}, mesh.piece(tet), mesh.region(tet), origin};
}

SurfaceChange SurfaceReplica::follow_tets(const Replica& mesh, const std::vector<std::uint32_t>& tets,
                                          std::span<const std::uint32_t> moved) {
  // A step of a simulation moves nearly every vertex, and most of them lie inside the body.
  if (tets.empty() && 2 * moved.size() > state_.vertices.size()) {
    std::uint64_t hash = state_.hash;
    SurfaceChange out = moved_surface(mesh, state_.vertices, moved, hash);
    state_.apply(parts_of(out), hash);
    state_.revision = mesh.revision();
    return out;
  }
  SurfaceChange out;
  MoreUses more_uses;
  for (const std::uint32_t t : tets) {
    for (int face = 0; face < 4; ++face) {
      const std::uint32_t id = 4 * t + static_cast<std::uint32_t>(face);
      const Triangle* old = state_.triangles.find(id);
      if (!mesh.alive(t) || !(mesh.boundary_mask(t) >> face & 1)) {
        if (old == nullptr) continue;
        more_uses.add(old->vertices, -1);
        out.removed_triangles.push_back(id);
        continue;
      }
      const Triangle now = triangle_of(mesh, t, face, old == nullptr ? kNoId : old->origin);
      if (old != nullptr) {
        if (*old == now) continue;
        more_uses.add(old->vertices, -1);
      }
      more_uses.add(now.vertices, 1);
      append(out, id, now);
    }
  }
  for (const std::uint32_t v : moved)
    if (state_.vertices.contains(v)) more_uses.add(v);
  for (const auto& [v, more] : more_uses.sorted()) {
    const Vertex* old = state_.vertices.find(v);
    if (std::int64_t{old == nullptr ? 0 : old->uses} + more == 0) {
      if (old != nullptr) out.removed_vertices.push_back(v);
      continue;
    }
    const std::array<float, 3> position = position_of(mesh, v);
    if (old == nullptr || !same_bits(old->position, position)) append(out, v, position);
    if (!mesh.deformed()) continue;
    // Named where the receiver would not know it; where it is new, in any case, since one that coalesced may know an older one.
    const std::array<float, 3> rest = rest_of(mesh, v);
    if (old == nullptr || !same_bits(old->has_rest ? old->rest_at : position, rest))
      append_rest(out, v, rest);
  }
  std::uint64_t hash = 0;
  state_.check(parts_of(out), hash);
  state_.apply(parts_of(out), hash);
  state_.revision = mesh.revision();
  return out;
}

void SurfaceReplica::load(const Replica& mesh) {
  state_ = {};
  staged_.reset();
  std::uint32_t near = kNoId;  // neighbours tend to have ids close together
  mesh.for_each_tet([&](std::uint32_t t) {
    for (int face = 0; face < 4; ++face) {
      if (!(mesh.boundary_mask(t) >> face & 1)) continue;
      const std::uint32_t id = 4 * t + static_cast<std::uint32_t>(face);
      const Triangle triangle = triangle_of(mesh, t, face, near);
      if (triangle.origin != kNoId) near = triangle.origin;
      state_.hash ^= hash_of(id, triangle);
      state_.triangles[id] = triangle;
      for (const std::uint32_t v : triangle.vertices) {
        Vertex& vertex = state_.vertices[v];
        if (vertex.uses++ > 0) continue;
        vertex.position = position_of(mesh, v);
        if (mesh.deformed()) {
          vertex.has_rest = true;
          vertex.rest_at = rest_of(mesh, v);
        }
        state_.hash ^= surface_vertex_hash(v, vertex.position.data());
      }
    }
  });
  state_.revision = mesh.revision();
}

SurfaceChange SurfaceReplica::follow(const Replica& mesh, const Delta& delta,
                                     std::span<const std::uint32_t> look_at) {
  std::vector<std::uint32_t> tets(delta.tets.ids.begin(), delta.tets.ids.end());
  tets.insert(tets.end(), delta.removed_tets.begin(), delta.removed_tets.end());
  tets.insert(tets.end(), look_at.begin(), look_at.end());
  sort_unique(tets);
  return follow_tets(mesh, tets, delta.moved_ids);
}

void SurfaceReplica::load_part(const SurfaceReplica& whole, const Box& box) {
  state_ = {};
  staged_.reset();
  std::vector<std::uint32_t> triangles;
  for (const auto& [id, triangle] : whole.triangles()) triangles.push_back(id);
  take_part(whole, box, triangles, {});
}

SurfaceChange SurfaceReplica::follow_part(const SurfaceReplica& whole, const TetIndex& index,
                                          const MeshChange& change, const Box& box) {
  std::vector<std::uint32_t> tets = change.tets;
  // A vertex that moves may take otherwise unchanged triangles into the box, or out of it.
  for (const std::uint32_t v : change.cut_moved) index.append_tets(v, tets);
  sort_unique(tets);
  std::vector<std::uint32_t> triangles;
  for (const std::uint32_t t : tets) {
    for (std::uint32_t id = 4 * t; id < 4 * t + 4; ++id) {
      const Triangle* now = whole.state_.triangles.find(id);
      if (now != nullptr || state_.triangles.contains(id)) triangles.push_back(id);
      if (now != nullptr) shell_.add(id, whole.corners(*now));
    }
  }
  if (!change.deformed) return take_part(whole, box, triangles, change.cut_moved);
  const auto look = [&](std::uint32_t id, const Triangle& now) {
    if (protocol::meets(box, whole.corners(now)) != state_.triangles.contains(id)) triangles.push_back(id);
  };
  if (shell_.covers(change.travel_m)) {
    for (const std::uint32_t id : shell_.ids())
      if (const Triangle* now = whole.state_.triangles.find(id)) look(id, *now);
  } else {
    shell_.begin(box, change.travel_m);
    for (const auto& [id, now] : whole.triangles()) {
      look(id, now);
      shell_.add(id, whole.corners(now));
    }
  }
  sort_unique(triangles);
  std::vector<std::uint32_t> moved;
  for (const auto& [v, vertex] : vertices()) {
    const Vertex* now = whole.state_.vertices.find(v);
    if (now != nullptr &&
        (!same_bits(vertex.position, now->position) || !same_bits(vertex.rest(), now->rest()))) {
      moved.push_back(v);
    }
  }
  return take_part(whole, box, triangles, moved);
}

SurfaceChange SurfaceReplica::take_part(const SurfaceReplica& whole, const Box& box,
                                        std::span<const std::uint32_t> triangles,
                                        std::span<const std::uint32_t> moved) {
  SurfaceChange out;
  MoreUses more_uses;
  for (const std::uint32_t v : moved) more_uses.add(v);
  for (const std::uint32_t id : triangles) {
    const Triangle* old = state_.triangles.find(id);
    const Triangle* now = whole.state_.triangles.find(id);
    const bool inside = now != nullptr && protocol::meets(box, whole.corners(*now));
    if (old != nullptr && inside && *old == *now) continue;
    if (old != nullptr) more_uses.add(old->vertices, -1);
    if (old != nullptr && !inside) out.removed_triangles.push_back(id);
    if (!inside) continue;
    more_uses.add(now->vertices, 1);
    append(out, id, *now);
  }
  for (const auto& [v, more] : more_uses.sorted()) {
    const Vertex* old = state_.vertices.find(v);
    if (std::int64_t{old == nullptr ? 0 : old->uses} + more == 0) {
      if (old != nullptr) out.removed_vertices.push_back(v);
      continue;
    }
    const Vertex& now = whole.state_.vertices.at(v);
    if (old == nullptr || !same_bits(old->position, now.position)) append(out, v, now.position);
    if (now.has_rest && (old == nullptr || !old->has_rest || !same_bits(old->rest_at, now.rest_at)))
      append_rest(out, v, now.rest_at);
  }
  std::uint64_t hash = 0;
  state_.check(parts_of(out), hash);
  state_.apply(parts_of(out), hash);
  state_.revision = whole.revision();
  return out;
}

std::array<Vec3, 3> SurfaceReplica::corners(const Triangle& triangle) const {
  const auto corner = [&](std::size_t i) -> Vec3 {
    const auto& p = state_.vertices.at(triangle.vertices[i]).position;
    return {double{p[0]}, double{p[1]}, double{p[2]}};
  };
  return {corner(0), corner(1), corner(2)};
}

SurfaceSnapshotWriter::SurfaceSnapshotWriter(const SurfaceReplica& surface, SnapshotCause cause,
                                             std::size_t chunk_elements)
    : surface_(surface),
      chunk_elements_(std::max<std::size_t>(1, chunk_elements)),
      next_vertex_(surface.vertices().begin()),
      next_triangle_(surface.triangles().begin()) {
  const auto chunks_of = [&](std::size_t n) { return (n + chunk_elements_ - 1) / chunk_elements_; };
  begin_.view = View::Surface;
  begin_.revision = surface.revision();
  begin_.cause = cause;
  begin_.vertex_count = static_cast<std::uint32_t>(surface.vertices().size());
  begin_.triangle_count = static_cast<std::uint32_t>(surface.triangles().size());
  begin_.chunks = static_cast<std::uint32_t>(chunks_of(surface.vertices().size()) +
                                             chunks_of(surface.triangles().size()));
}

bool SurfaceSnapshotWriter::next() {
  if (chunks_made_ == begin_.chunks) return false;
  arrays_ = {};
  chunk_ = {};
  chunk_.index = chunks_made_++;
  if (next_vertex_ != surface_.vertices().end()) {
    for (; next_vertex_ != surface_.vertices().end() && arrays_.vertex_ids.size() < chunk_elements_;
         ++next_vertex_) {
      const auto [id, vertex] = *next_vertex_;
      append(arrays_, id, vertex.position);
      if (vertex.has_rest) append_rest(arrays_, id, vertex.rest_at);
    }
  } else {
    const auto end = surface_.triangles().end();
    for (; next_triangle_ != end && arrays_.triangle_ids.size() < chunk_elements_; ++next_triangle_) {
      const auto [id, triangle] = *next_triangle_;
      append(arrays_, id, triangle);
    }
  }
  chunk_.surface_vertices = arrays_.vertices();
  chunk_.triangles = arrays_.triangles();
  chunk_.surface_rest = arrays_.rest();
  return true;
}

}  // namespace incise::protocol
