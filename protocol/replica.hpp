#pragma once

// The state that a stream describes: what a client with view Volume holds, and the server's own mirror. Both
// apply the same deltas with this code.

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "protocol/limits.hpp"
#include "protocol/messages.hpp"
#include "protocol/tet_faces.hpp"

namespace incise::protocol {

// Why a snapshot part or a delta was refused. The state is then as it was.
enum class ApplyError {
  None,
  WrongBase,     // a delta that does not start at this revision: ask for a resync, or resume
  OutOfOrder,    // a snapshot part without its beginning, or not the next one
  BadShape,      // arrays that do not fit together
  BadIndex,      // an id out of range, dead, twice, or not where it must be
  LimitReached,  // more than this replica may hold
  HashMismatch,  // the message is consistent, but the state differs from the sender's
};

struct ApplyResult {
  ApplyError error = ApplyError::None;
  std::string text;  // one line; empty without an error

  explicit operator bool() const { return error == ApplyError::None; }
};

class TetIndex;

// Thread: one, at a time, for reading as well: what hangs together is found when somebody asks. Owns: the arrays.
class Replica {
 public:
  explicit Replica(std::uint32_t max_vertices = kDefaultReplicaVertices,
                   std::uint32_t max_tets = kDefaultReplicaTets)
      : max_vertices_(max_vertices), max_tets_(max_tets) {}

  // A copy has the state, and no snapshot that has begun. O(mesh).
  Replica(const Replica& other)
      : max_vertices_(other.max_vertices_), max_tets_(other.max_tets_), state_(other.state_) {}
  // Into the memory that is there, unless most of that would be left over.
  Replica& operator=(const Replica& other);
  Replica(Replica&&) noexcept = default;
  Replica& operator=(Replica&&) noexcept = default;
  ~Replica() = default;

  // Replaces the state by a whole mesh, all in piece 0. `positions`: x y z for each vertex. O(mesh).
  ApplyResult load(std::span<const double> positions, const TetArrays& tets, std::uint64_t revision);

  // A snapshot: begin, its chunks in order, end. The old state stays in force until end() has checked
  // the whole; a part that is refused abandons the snapshot.
  ApplyResult begin(const SnapshotBegin& part);
  ApplyResult chunk(const SnapshotChunk& part);
  ApplyResult end(const SnapshotEnd& part);
  // Chunks of the current snapshot that have arrived, and how many it has; 0 and 0 without one.
  std::uint32_t chunks_done() const { return staged_ ? staged_->chunks_done : 0; }
  std::uint32_t chunks_total() const { return staged_ ? staged_->begin.chunks : 0; }

  // From base_revision to revision, completely or not at all. Checks every index and, last, the state hash.
  // O(delta).
  ApplyResult apply(const Delta& delta);

  std::uint64_t revision() const { return state_.revision; }
  // Of the whole state, kept up to date.
  std::uint64_t state_hash() const { return state_.hash; }
  // The same from scratch. O(mesh).
  std::uint64_t compute_state_hash() const;

  // Ids run below these; a vertex below vertex_count() always exists, a tetrahedron where alive() says so.
  std::uint32_t vertex_count() const { return static_cast<std::uint32_t>(state_.positions.size() / 3); }
  std::uint32_t tet_slots() const { return static_cast<std::uint32_t>(state_.tets.size()); }
  std::uint32_t live_tets() const { return state_.live_tets; }
  std::uint32_t boundary_faces() const { return state_.boundary_faces; }

  // x y z of all vertices, metres.
  std::span<const double> positions() const { return state_.positions; }
  Vec3 position(std::uint32_t vertex) const {
    const double* p = &state_.positions[3 * std::size_t{vertex}];
    return {p[0], p[1], p[2]};
  }
  // Whether a simulator has deformed the body. From then on each vertex has a rest position: where its material is in the
  // body at rest. Until then that is its position.
  bool deformed() const { return !state_.rest.empty(); }
  std::span<const double> rest_positions() const { return deformed() ? state_.rest : state_.positions; }
  bool alive(std::uint32_t tet) const { return tet < tet_slots() && state_.tets[tet][0] != kNoId; }
  const std::array<std::uint32_t, 4>& vertices(std::uint32_t tet) const { return state_.tets[tet]; }
  std::int32_t region(std::uint32_t tet) const { return state_.regions.empty() ? 0 : state_.regions[tet]; }
  std::uint8_t cut_mask(std::uint32_t tet) const { return state_.cut_masks[tet]; }
  std::uint8_t boundary_mask(std::uint32_t tet) const { return state_.boundary_masks[tet]; }
  // The piece of each tetrahedron slot: 0 where there is none. O(mesh) if the mesh has changed since the last call.
  std::span<const std::uint32_t> pieces() const {
    if (!state_.pieces_known) find_pieces();
    return state_.pieces;
  }
  std::uint32_t piece(std::uint32_t tet) const { return pieces()[tet]; }
  // The pieces there are but 0, each with one of its tetrahedra: it is what hangs together with that.
  const std::map<std::uint32_t, std::uint32_t>& piece_names() const { return state_.names; }
  // The vertices of face `face` of a live tetrahedron, counter-clockwise from outside.
  std::array<std::uint32_t, 3> face_vertices(std::uint32_t tet, int face) const;

  // Calls f(id) for each live tetrahedron, ascending.
  template <class F>
  void for_each_tet(F&& f) const {
    for (std::uint32_t t = 0; t < tet_slots(); ++t) {
      if (state_.tets[t][0] != kNoId) f(t);
    }
  }
  // Calls f(tet, face) for each boundary face, ascending by half-face.
  template <class F>
  void for_each_boundary_face(F&& f) const {
    for_each_tet([&](std::uint32_t t) {
      for (int face = 0; face < 4; ++face) {
        if (state_.boundary_masks[t] >> face & 1) f(t, face);
      }
    });
  }

  // The state as bytes, the same for any two replicas of it however they reached it. PROTOCOL.md,
  // "Canonical bytes", is the format. O(mesh).
  std::vector<std::byte> canonical_bytes() const;

  // ---- The server's side ----

  // After each apply(), of a replica whose pieces are known: keeps them known, and appends to `changed` the tetrahedra that were in
  // another piece before; new ones are left out. O(delta + what is cut off).
  void follow_pieces(const TetIndex& index, const Delta& delta, std::vector<std::uint32_t>& changed);

 private:
  struct State {
    std::uint64_t revision = 0;
    std::uint64_t hash = 0;
    std::uint64_t vertices_hash = 0;  // the vertices' part of it
    std::uint32_t live_tets = 0;
    std::uint32_t boundary_faces = 0;
    std::vector<double> positions;
    std::vector<double> rest;                        // empty until the body deforms
    std::vector<std::array<std::uint32_t, 4>> tets;  // [0] == kNoId: no such tetrahedron
    std::vector<std::int32_t> regions;               // empty: all are 0
    std::vector<std::uint8_t> cut_masks, boundary_masks;
    std::map<std::uint32_t, std::uint32_t>
        names;                                  // a tetrahedron by piece; one that is gone where the piece is
    mutable std::vector<std::uint32_t> pieces;  // by tetrahedron
    mutable bool pieces_known = false;

    void resize_tets(std::size_t slots);
    void set_tet(const TetArrays& tets, std::size_t i);
  };
  struct Staged {
    SnapshotBegin begin;
    std::uint32_t chunks_done = 0;
    std::uint32_t next_tet = 0;  // ids still to come are not below it
    State state;
  };

  ApplyResult add(State& state, std::uint32_t& next_tet, std::uint32_t vertex_limit,
                  const TetArrays& tets) const;
  ApplyResult check(const Delta& delta) const;
  ApplyResult abandon(ApplyResult why);
  // The hash after it, and the vertices' part.
  std::pair<std::uint64_t, std::uint64_t> hashes_after(const Delta& delta) const;
  // By what the moves change the vertices' part.
  std::uint64_t hash_of_moves(const Delta& delta) const;
  void apply_rest(const Delta& delta);
  void find_pieces() const;

  std::uint32_t max_vertices_;
  std::uint32_t max_tets_;
  State state_;
  std::unique_ptr<Staged> staged_;
};

// The parts of a snapshot of `replica`, one at a time, each valid until the next call: how a server sends one
// without holding it twice.
//
//   SnapshotWriter writer(mirror, SnapshotCause::Join);
//   send(writer.begin());
//   while (writer.next()) send(writer.chunk());
//   send(writer.end());
class SnapshotWriter {
 public:
  // `replica` must stay as it is while the writer is used.
  SnapshotWriter(const Replica& replica, SnapshotCause cause, std::size_t chunk_elements = kChunkElements);

  const SnapshotBegin& begin() const { return begin_; }
  // Moves on to the next chunk; false after the last. O(chunk).
  bool next();
  const SnapshotChunk& chunk() const { return chunk_; }
  SnapshotEnd end() const { return {begin_.revision, replica_.state_hash(), 0}; }

 private:
  const Replica& replica_;
  std::size_t chunk_elements_;
  SnapshotBegin begin_;
  SnapshotChunk chunk_;
  std::uint32_t chunks_made_ = 0;
  std::uint32_t next_vertex_ = 0;
  std::uint32_t next_tet_ = 0;
  std::vector<std::uint32_t> ids_, vertices_, piece_ids_, piece_names_;
  std::vector<std::int32_t> regions_;
  std::vector<std::uint8_t> cut_masks_, boundary_masks_;
};

}  // namespace incise::protocol
