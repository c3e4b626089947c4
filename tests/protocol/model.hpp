#pragma once

// What a Replica should hold, told in the plainest way: maps, and a hash from scratch. The difference of two
// models is the delta between them.

#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <map>
#include <random>
#include <vector>

#include "protocol/coalesce.hpp"
#include "protocol/replica.hpp"

namespace incise::protocol {

struct Model {
  struct Tet {
    std::array<std::uint32_t, 4> vertices{};
    std::int32_t region = 0;
    std::uint8_t cut_mask = 0, boundary_mask = 0;
    std::uint32_t piece = 0;
    friend bool operator==(const Tet&, const Tet&) = default;
  };
  struct Origin {
    std::uint32_t a = 0, b = 0;
    double t = 0;
  };

  std::uint64_t revision = 0;
  std::vector<std::array<double, 3>> positions;
  std::map<std::uint32_t, Origin> origins;  // of added vertices
  std::map<std::uint32_t, Tet> tets;
  std::uint32_t next_tet = 0;                            // ids below it have been used
  std::map<std::uint32_t, std::uint32_t> names{{0, 0}};  // the pieces, with a tetrahedron of each
  std::uint32_t next_piece = 1;

  std::uint64_t hash() const;
  // Puts each tetrahedron into the piece of what it shares vertices with. A part of a piece that has not got the piece's
  // tetrahedron becomes a new piece, or takes the id over where that tetrahedron is gone.
  void find_pieces();
  // The replica that holds this, by way of a snapshot.
  Replica replica() const;
};

// From `a` to `b`, with `step` entries for the revisions between.
OwnedDelta difference(const Model& a, const Model& b);

// A box of nx x ny x nz cubes of 1 cm, six tetrahedra each.
Model box_model(std::uint32_t nx, std::uint32_t ny, std::uint32_t nz);

// A random change that leaves a state which messages can describe (it need not be a mesh that could be cut):
// vertices move and are added, tetrahedra change, come and go, masks and pieces change. Revision + 1.
void mutate(Model& model, std::mt19937_64& random);

// Whether the replica holds exactly this.
::testing::AssertionResult holds(const Replica& replica, const Model& model);

}  // namespace incise::protocol
