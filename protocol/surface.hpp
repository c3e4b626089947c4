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
#include "protocol/surface_asset.hpp"

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
  std::vector<std::uint32_t> triangle_origins;  // empty: none has one
  std::vector<std::uint32_t> removed_triangles;
  std::vector<std::uint32_t> rest_ids;
  std::vector<float> rest_positions;

  SurfaceVertexArrays vertices() const { return {vertex_ids, vertex_positions}; }
  TriangleArrays triangles() const {
    return {triangle_ids,    triangle_vertices, triangle_flags,
            triangle_pieces, triangle_regions,  triangle_origins};
  }
  SurfaceVertexArrays rest() const { return {rest_ids, rest_positions}; }
};

// Thread: one, at a time. Owns: the arrays. Memory in proportion to what it was sent and, whatever the ids, 64 MB at most.
class SurfaceReplica {
 public:
  struct Triangle {
    std::array<std::uint32_t, 3> vertices{};
    std::uint8_t flags = 0;
    std::uint32_t piece = 0;
    std::int32_t region = 0;
    std::uint32_t origin =
        kNoId;  // the triangle of the surface that the body was filled from; cut faces have none
    friend bool operator==(const Triangle&, const Triangle&) = default;
  };
  struct Vertex {
    std::array<float, 3> position{};
    std::uint32_t uses = 0;  // triangles at it
    bool has_rest = false;   // else it rests at `position`
    std::array<float, 3> rest_at{};

    // Where its material is in the body at rest.
    const std::array<float, 3>& rest() const { return has_rest ? rest_at : position; }
  };

  SurfaceReplica() = default;
  // As in Replica. O(surface).
  SurfaceReplica(const SurfaceReplica& other) : state_(other.state_), origins_(other.origins_) {}
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
  // Where the corners of one of its triangles are in the body at rest: with its origin, what SurfaceLookup asks for.
  Corners rest_corners(const Triangle& triangle) const;
  // About how much memory it takes.
  std::size_t bytes() const {
    return state_.triangles.size() * (sizeof(Triangle) + 48) + state_.vertices.size() * (sizeof(Vertex) + 48);
  }

  // The state as bytes, the same for any two replicas of it; PROTOCOL.md, "Canonical bytes".
  std::vector<std::byte> canonical_bytes() const;

  // ---- The server's side ----

  // Finds origins with this tree from the next load() on; null: triangles have none.
  void set_origins(std::shared_ptr<const OriginTree> origins) { origins_ = std::move(origins); }
  bool finds_origins() const { return origins_ != nullptr; }
  // Makes this the whole surface of `mesh`. O(mesh).
  void load(const Replica& mesh);
  // What `delta`, which `mesh` has just applied, changes on the surface; makes the change here too. `look_at`: further tetrahedra whose
  // triangles may have changed: those in other pieces (Replica::follow_pieces()), and, for their origins, those at vertices that a cut has
  // moved. The ids come ascending; hash and revision are this replica's after it. O(delta).
  SurfaceChange follow(const Replica& mesh, const Delta& delta, std::span<const std::uint32_t> look_at);

  // Makes this the part of `whole` that touches `box`: the triangles whose own bounding box meets it, bounds included.
  // O(surface).
  void load_part(const SurfaceReplica& whole, const Box& box);
  // Brings this part from the state before `change` to that of `whole`, which has applied it, and returns what
  // changed. `index` is that of the mesh. O(change x tetrahedra at a vertex); of a deformation O(part), and
  // every few steps O(surface).
  SurfaceChange follow_part(const SurfaceReplica& whole, const TetIndex& index, const MeshChange& change,
                            const Box& box);

 private:
  // What a delta or a chunk changes.
  struct Parts {
    SurfaceVertexArrays vertices;
    std::span<const std::uint32_t> removed_vertices;
    TriangleArrays triangles;
    std::span<const std::uint32_t> removed_triangles;
    SurfaceVertexArrays rest;
  };
  static Parts parts_of(const SurfaceChange& change);
  struct State {
    std::uint64_t revision = 0;
    std::uint64_t hash = 0;
    IdMap<Triangle> triangles;
    IdMap<Vertex> vertices;

    // Why the change must be refused, or no error; `hash_after`: the hash after it.
    ApplyResult check(const Parts& parts, std::uint64_t& hash_after) const;
    // Makes a change that check() has accepted.
    void apply(const Parts& parts, std::uint64_t hash_after);
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

  Triangle triangle_of(const Replica& mesh, std::uint32_t tet, int face, std::uint32_t origin_near) const;

  State state_;
  std::unique_ptr<Staged> staged_;
  BoxShell shell_;  // of a part that the server keeps
  std::shared_ptr<const OriginTree> origins_;
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
