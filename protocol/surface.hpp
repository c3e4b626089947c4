#pragma once

// View Surface: the boundary triangles of the mesh and their vertices in single precision. A client holds a
// SurfaceReplica; the server holds one too, in addition to its Replica, and finds with it what to send.

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "protocol/box_follow.hpp"
#include "protocol/id_map.hpp"
#include "protocol/messages.hpp"
#include "protocol/replica.hpp"

namespace incise::protocol {

// A surface delta or chunk that owns its arrays.
struct SurfaceChange {
  std::vector<std::uint32_t> vertex_ids;
  std::vector<float> vertex_positions;
  std::vector<std::uint32_t> removed_vertices;
  std::vector<std::uint32_t> triangle_ids, triangle_vertices;
  std::vector<std::uint8_t> triangle_flags;
  std::vector<std::uint32_t> triangle_pieces;
  std::vector<std::int32_t> triangle_regions;
  std::vector<std::uint32_t> removed_triangles;

  SurfaceVertexArrays vertices() const { return {vertex_ids, vertex_positions}; }
  TriangleArrays triangles() const {
    return {triangle_ids, triangle_vertices, triangle_flags, triangle_pieces, triangle_regions};
  }
};

// Thread: one, at a time. Owns: the arrays. Memory in proportion to what it was sent and, whatever the ids, 64 MB at most.
class SurfaceReplica {
 public:
  struct Triangle {
    std::array<std::uint32_t, 3> vertices{};
    std::uint8_t flags = 0;
    std::uint32_t piece = 0;
    std::int32_t region = 0;
    friend bool operator==(const Triangle&, const Triangle&) = default;
  };
  struct Vertex {
    std::array<float, 3> position{};
    std::uint32_t uses = 0;  // triangles at it
  };

  SurfaceReplica() = default;
  // As in Replica. O(surface).
  SurfaceReplica(const SurfaceReplica& other) : state_(other.state_) {}
  SurfaceReplica& operator=(const SurfaceReplica& other) { return *this = SurfaceReplica(other); }
  SurfaceReplica(SurfaceReplica&&) noexcept = default;
  SurfaceReplica& operator=(SurfaceReplica&&) noexcept = default;
  ~SurfaceReplica() = default;

  // As in Replica: the old state stays in force until end() has checked the whole new one.
  ApplyResult begin(const SnapshotBegin& part);
  ApplyResult chunk(const SnapshotChunk& part);
  ApplyResult end(const SnapshotEnd& part);
  std::uint32_t chunks_done() const { return staged_ ? staged_->chunks_done : 0; }
  std::uint32_t chunks_total() const { return staged_ ? staged_->begin.chunks : 0; }

  // From base_revision to revision, completely or not at all. O(delta).
  ApplyResult apply(const SurfaceDelta& delta);

  std::uint64_t revision() const { return state_.revision; }
  std::uint64_t surface_hash() const { return state_.hash; }
  // The same from scratch. O(surface).
  std::uint64_t compute_surface_hash() const;

  // By half-face and by vertex id, ascending.
  const IdMap<Triangle>& triangles() const { return state_.triangles; }
  const IdMap<Vertex>& vertices() const { return state_.vertices; }
  // About how much memory it takes.
  std::size_t bytes() const {
    return state_.triangles.size() * (sizeof(Triangle) + 48) + state_.vertices.size() * (sizeof(Vertex) + 48);
  }

  // The state as bytes, the same for any two replicas of it; PROTOCOL.md, "Canonical bytes".
  std::vector<std::byte> canonical_bytes() const;

  // ---- The server's side ----

  // Makes this the whole surface of `mesh`. O(mesh).
  void load(const Replica& mesh);
  // What `delta`, which `mesh` has just applied, changes on the surface; makes the change here too. `in_other_pieces`: see
  // Replica::follow_pieces(). The ids come ascending; hash and revision are this replica's after it. O(delta).
  SurfaceChange follow(const Replica& mesh, const Delta& delta,
                       std::span<const std::uint32_t> in_other_pieces);

  // Makes this the part of `whole` that touches `box`: the triangles whose own bounding box meets it, bounds included.
  // O(surface).
  void load_part(const SurfaceReplica& whole, const Box& box);
  // Brings this part from the state before `change` to that of `whole`, which has applied it, and returns what
  // changed. `index` is that of the mesh. O(change x tetrahedra at a vertex); of a deformation O(part), and
  // every few steps O(surface).
  SurfaceChange follow_part(const SurfaceReplica& whole, const TetIndex& index, const MeshChange& change,
                            const Box& box);

 private:
  struct State {
    std::uint64_t revision = 0;
    std::uint64_t hash = 0;
    IdMap<Triangle> triangles;
    IdMap<Vertex> vertices;

    // Why the change must be refused, or no error; `hash_after`: the hash after it.
    ApplyResult check(const SurfaceVertexArrays& vertices, std::span<const std::uint32_t> removed_vertices,
                      const TriangleArrays& triangles, std::span<const std::uint32_t> removed_triangles,
                      std::uint64_t& hash_after) const;
    // Makes a change that check() has accepted.
    void apply(const SurfaceVertexArrays& vertices, std::span<const std::uint32_t> removed_vertices,
               const TriangleArrays& triangles, std::span<const std::uint32_t> removed_triangles,
               std::uint64_t hash_after);
  };
  struct Staged {
    SnapshotBegin begin;
    std::uint32_t chunks_done = 0;
    State state;
  };

  ApplyResult abandon(ApplyResult why);
  std::array<Vec3, 3> corners(const Triangle& triangle) const;
  SurfaceChange take_part(const SurfaceReplica& whole, const Box& box,
                          std::span<const std::uint32_t> triangles, std::span<const std::uint32_t> moved);
  SurfaceChange follow_tets(const Replica& mesh, const std::vector<std::uint32_t>& tets,
                            std::span<const std::uint32_t> moved);

  State state_;
  std::unique_ptr<Staged> staged_;
  BoxShell shell_;  // of a part that the server keeps
};

// The parts of a surface snapshot, as SnapshotWriter makes those of a volume.
class SurfaceSnapshotWriter {
 public:
  // `surface` must stay as it is while the writer is used.
  SurfaceSnapshotWriter(const SurfaceReplica& surface, SnapshotCause cause,
                        std::size_t chunk_elements = kChunkElements);

  const SnapshotBegin& begin() const { return begin_; }
  // Moves on to the next chunk; false after the last. O(chunk).
  bool next();
  const SnapshotChunk& chunk() const { return chunk_; }
  // `state_hash`: of the whole mesh at this revision.
  SnapshotEnd end(std::uint64_t state_hash) const {
    return {begin_.revision, state_hash, surface_.surface_hash()};
  }

 private:
  const SurfaceReplica& surface_;
  std::size_t chunk_elements_;
  SnapshotBegin begin_;
  SnapshotChunk chunk_;
  std::uint32_t chunks_made_ = 0;
  IdMap<SurfaceReplica::Vertex>::Iterator next_vertex_;
  IdMap<SurfaceReplica::Triangle>::Iterator next_triangle_;
  SurfaceChange arrays_;
};

}  // namespace incise::protocol
