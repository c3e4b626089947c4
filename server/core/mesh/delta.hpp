#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"
#include "server/core/stroke/blade.hpp"

namespace incise::core {

// Face f of tetrahedron t, the one opposite to its vertex f, as 4 t + f.
using HalfFace = std::uint32_t;

// Where a new vertex comes from: its fields are (1-t) a + t b. A copy has a == b and t == 0.
struct Provenance {
  VertexId a = kNone;
  VertexId b = kNone;
  double t = 0;

  friend bool operator==(const Provenance&, const Provenance&) = default;
};

// The material that a vertex stands for after a step: its fields are the sum of weights[k] times those that vertex from[k] had
// before. The weights add up to 1; of a place outside the body, beyond a curved boundary, some are negative.
struct Blend {
  VertexId vertex = kNone;
  std::array<VertexId, 4> from{};
  std::array<double, 4> weights{};

  friend bool operator==(const Blend&, const Blend&) = default;
};

// A tetrahedron as clients see it.
struct TetState {
  TetId id = kNone;
  std::array<VertexId, 4> vertices{};
  std::int32_t region = 0;
  std::uint8_t cut_mask = 0;       // bit f: face f was opened by a cut
  std::uint8_t boundary_mask = 0;  // bit f: face f is on the boundary (cut faces are)

  friend bool operator==(const TetState&, const TetState&) = default;
};

// What became of the vertices that a host simulation has sent.
struct Deformation {
  std::uint64_t frame = 0;        // the simulation's number for them
  std::uint32_t moved = 0;        // lie elsewhere now
  std::uint32_t passed_over = 0;  // were cut or made after the revision that it computed with, or are dead
  std::vector<VertexId>
      held;  // stayed, or went half the way, ascending: at a blade, or a tetrahedron would invert
};

// One committed step: takes revision - 1 to revision. Owns its arrays; immutable once it has left the core.
// Ids are never reused: added vertices are first_added, first_added + 1, ... and new tetrahedra count on likewise.
struct Delta {
  std::uint64_t revision = 0;
  std::uint32_t source = 0;  // which blade
  std::uint32_t stroke = 0;  // counts the strokes of all sources, from 1; 0: no cut, the body deformed
  std::uint32_t batch = 0;   // within the stroke, from 1; a long one comes in several steps
  bool stroke_ended = false;
  // The step opened faces. A stroke along a cut that is there may move its vertices a little: nobody would call that a cut.
  bool has_cut() const { return cut_faces > 0; }

  std::vector<VertexId> moved;  // vertices that existed before and now lie elsewhere, ascending
  std::vector<Vec3> moved_positions;
  VertexId first_added = 0;
  std::vector<Vec3> added_positions;
  // Rest positions of `moved` and of the added vertices, where a cut has moved them in a body that is deformed; else empty.
  std::vector<Vec3> moved_rest, added_rest;
  std::vector<Provenance> provenance;
  // Of vertices that existed and to which a cut gave other material, and of added ones that no longer lie between their parents
  // as these are after the step: ascending. Fields follow from all blends at once, then from the provenance of the other
  // added vertices, in order.
  std::vector<Blend> blends;
  std::vector<TetState> upserted;  // new or changed tetrahedra, ascending by id
  std::vector<TetId> removed;      // ascending
  std::vector<TetId>
      elders;  // of the new ones, which come last: one from before the step, in whose place it is
  // Boundary faces that appeared or whose vertices changed, and those that went, as half-faces: ascending.
  std::vector<HalfFace> boundary_upserted;
  std::vector<HalfFace> boundary_removed;
  // What is cut off, the smaller side, gets a new id; all begin in piece 0. A piece is named by one of its tetrahedra: it is what
  // hangs together with that through faces, or, the same, through vertices. Here are the pieces that are new and those whose
  // tetrahedron is gone, ids ascending; piece 0 is what no other is, and not named.
  struct Piece {
    std::uint32_t id = 0;
    TetId tet = kNone;
    std::uint32_t tets = 0;  // how many it has
    friend bool operator==(const Piece&, const Piece&) = default;
  };
  std::vector<Piece> pieces;

  // Where the blade was over this batch: its first and its last line, and the source times of both.
  BladeLine from, to;
  std::int64_t from_t_ns = 0, to_t_ns = 0;

  // What the step has laid open, one side of it: opened faces, and what removed tetrahedra leave.
  std::uint32_t cut_faces = 0;
  double cut_area = 0;  // m^2
  std::uint32_t snaps = 0, splits = 0;
  double min_dihedral_deg = 180;  // over upserted tetrahedra and those around moved vertices
  double max_deviation_h = 0;     // of the new cut faces' vertices from the swept surface
  std::uint64_t state_hash = 0;   // of the whole mesh after this step (protocol/state_hash.hpp)
  Deformation deformation;        // of a step without a stroke
};

}  // namespace incise::core
