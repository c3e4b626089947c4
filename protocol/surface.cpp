#include "protocol/surface.hpp"

#include <algorithm>
#include <memory>

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

}  // namespace

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

}  // namespace incise::protocol
