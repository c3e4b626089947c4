#pragma once

// View Volume with a box of interest: the tetrahedra that touch the box, and their vertices. A client holds a VolumePart;
// the server holds one for each session with a box, and finds with it what to send.

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "protocol/box_follow.hpp"
#include "protocol/coalesce.hpp"
#include "protocol/id_map.hpp"
#include "protocol/messages.hpp"
#include "protocol/replica.hpp"

namespace incise::protocol {

class MoreUses;

// Thread: one, at a time. Owns: the arrays. Memory in proportion to what it was sent and, whatever the ids, 16 MB at most.
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

  // As in Replica: the old state stays in force until end() has checked the whole new one.
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
  const IdMap<Tet>& tets() const { return state_.tets; }
  const IdMap<Vertex>& vertices() const { return state_.vertices; }
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
  // Brings this part from the state before `change` to that of `whole`, which has applied it, and returns the delta
  // that does so. `index` is that of `whole`. O(change x tetrahedra at a vertex); of a deformation O(part),
  // and every few steps O(mesh).
  OwnedDelta follow_part(const Replica& whole, const TetIndex& index, const MeshChange& change,
                         const Box& box);
  // Elements that the last follow_part() looked at.
  std::size_t looked_at() const { return looked_at_; }

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
    IdMap<Tet> tets;
    IdMap<Vertex> vertices;

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
  std::vector<std::uint32_t> tets_to_look_at(const Replica& whole, const TetIndex& index,
                                             const MeshChange& change, const Box& box);
  void add_moved(const Replica& whole, const MeshChange& change, MoreUses& out);

  State state_;
  std::unique_ptr<Staged> staged_;
  BoxShell shell_;  // of a part that the server keeps
  std::size_t looked_at_ = 0;
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
  IdMap<VolumePart::Vertex>::Iterator next_vertex_;
  IdMap<VolumePart::Tet>::Iterator next_tet_;
  OwnedDelta arrays_;
  std::vector<std::uint32_t> pieces_;
};

}  // namespace incise::protocol
