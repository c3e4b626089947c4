// The server's side of a surface: follows the mesh or a whole surface, and is sent as a snapshot.

#include <algorithm>
#include <cstring>

#include "protocol/apply_checks.hpp"
#include "protocol/state_hash.hpp"
#include "protocol/surface.hpp"
#include "protocol/vertex_hashes.hpp"

namespace incise::protocol {
namespace {

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
  const auto hash_at = [&](const std::vector<float>& positions) {
    return SurfaceVertexHashes::combined(out.vertex_ids.size(), out.vertex_ids.data(), positions.data());
  };
  hash ^= hash_at(before) ^ hash_at(out.vertex_positions);
  return out;
}

}  // namespace

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
      state_.hash ^= triangle_hash(id, triangle.vertices.data(), triangle.flags);
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
