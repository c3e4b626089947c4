#pragma once

// View Volume with a box of interest: the tetrahedra that touch the box, and their vertices. A client holds a VolumePart;
// the server holds one for each session with a box, and finds with it what to send.

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "protocol/coalesce.hpp"
#include "protocol/messages.hpp"
#include "protocol/replica.hpp"

namespace incise::protocol {

// The tetrahedra at each vertex of a whole mesh, to find what a vertex that moves takes along: a linked list of corners
// (4 tetrahedron + place) for each vertex.
//
// Thread: one, at a time. Owns: its lists, 16 bytes a tetrahedron.
class TetIndex {
 public:
  // Of all of `mesh`. O(mesh).
  void load(const Replica& mesh);
  // What `delta` changes; `before` has not applied it yet. O(delta x tetrahedra at a vertex).
  void follow(const Replica& before, const Delta& delta);
  // Appends the tetrahedra that have `vertex`.
  void append_tets(std::uint32_t vertex, std::vector<std::uint32_t>& out) const;

 private:
  void link(std::uint32_t vertex, std::uint32_t corner);
  void unlink(std::uint32_t vertex, std::uint32_t corner);
  std::vector<std::uint32_t> first_, next_;  // by vertex, by corner; kNoId ends a list
};

// Thread: one, at a time. Owns: the arrays. Memory in proportion to what it was sent, whatever the ids.
class VolumePart {
 public:
  struct Tet {
    std::array<std::uint32_t, 4> vertices{};
    std::int32_t region = 0;
    std::uint8_t cut_mask = 0, boundary_mask = 0;
    std::uint32_t piece = 0;
    friend bool operator==(const Tet&, const Tet&) = default;
  };
  struct Vertex {
    Vec3 position;
    std::uint32_t uses = 0;  // tetrahedra at it, of the part
  };

  // As Replica's: the state before it stays in force until end() has checked the whole.
  ApplyResult begin(const SnapshotBegin& part);
  ApplyResult chunk(const SnapshotChunk& part);
  ApplyResult end(const SnapshotEnd& part);
  std::uint32_t chunks_done() const { return staged_ ? staged_->chunks_done : 0; }
  std::uint32_t chunks_total() const { return staged_ ? staged_->begin.chunks : 0; }

  // From base_revision to revision, completely or not at all. O(delta log part).
  ApplyResult apply(const Delta& delta);

  std::uint64_t revision() const { return state_.revision; }
  std::uint64_t part_hash() const { return state_.hash; }
  // The same from scratch. O(part).
  std::uint64_t compute_part_hash() const;

  // By id, ascending.
  const std::map<std::uint32_t, Tet>& tets() const { return state_.tets; }
  const std::map<std::uint32_t, Vertex>& vertices() const { return state_.vertices; }
  // About how much memory it takes.
  std::size_t bytes() const {
    return state_.tets.size() * (sizeof(Tet) + 48) + state_.vertices.size() * (sizeof(Vertex) + 48);
  }

  // The state as bytes, the same for any two replicas of it; PROTOCOL.md, "Canonical bytes".
  std::vector<std::byte> canonical_bytes() const;

  // ---- The server's side ----

  // Makes this the part of `whole` that touches `box`: the tetrahedra whose own bounding box meets it, bounds included.
  // O(mesh).
  void load_part(const Replica& whole, const Box& box);
  // Where this was that part of the mesh that `delta` has since brought to `whole`: makes it that of the mesh now, and
  // returns the delta that does so. `index` is that of `whole`. O(delta log part).
  OwnedDelta follow_part(const Replica& whole, const TetIndex& index, const Delta& delta, const Box& box);

 private:
  // What a chunk or a delta does, but for the pieces.
  struct Change {
    std::span<const std::uint32_t> set_ids, added_ids, removed_vertices;
    std::span<const double> set_positions, added_positions;
    TetArrays tets;
    std::span<const std::uint32_t> removed_tets;
  };
  struct State {
    std::uint64_t revision = 0;
    std::uint64_t hash = 0;
    std::map<std::uint32_t, Tet> tets;
    std::map<std::uint32_t, Vertex> vertices;

    // What stands against the change, or nothing; and what the hash would be after it.
    ApplyResult check(const Change& change, std::uint64_t& hash_after) const;
    // A change that check() has let pass.
    void apply(const Change& change, std::uint64_t hash_after);
    void set_pieces(const Delta& delta);
  };
  struct Staged {
    SnapshotBegin begin;
    std::uint32_t chunks_done = 0;
    State state;
  };
  static Change change_of(const Delta& delta);
  ApplyResult check_pieces(const Delta& delta) const;
  ApplyResult abandon(ApplyResult why);

  State state_;
  std::unique_ptr<Staged> staged_;
};

// The parts of a snapshot of a VolumePart, as SnapshotWriter makes those of a volume.
class VolumePartWriter {
 public:
  // `part` must stay as it is while the writer is used.
  VolumePartWriter(const VolumePart& part, const Box& box, SnapshotCause cause,
                   std::size_t chunk_elements = kChunkElements);

  const SnapshotBegin& begin() const { return begin_; }
  // Moves on to the next chunk; false after the last. O(chunk).
  bool next();
  const SnapshotChunk& chunk() const { return chunk_; }
  // `state_hash`: of the whole mesh at this revision.
  SnapshotEnd end(std::uint64_t state_hash) const {
    return {begin_.revision, state_hash, 0, part_.part_hash()};
  }

 private:
  const VolumePart& part_;
  std::size_t chunk_elements_;
  SnapshotBegin begin_;
  SnapshotChunk chunk_;
  std::uint32_t chunks_made_ = 0;
  std::map<std::uint32_t, VolumePart::Vertex>::const_iterator next_vertex_;
  std::map<std::uint32_t, VolumePart::Tet>::const_iterator next_tet_;
  OwnedDelta arrays_;
  std::vector<std::uint32_t> pieces_;
};

}  // namespace incise::protocol
