#pragma once

// Finds the elements that a server must look at after a step to keep the parts of a mesh in boxes of interest up to
// date, at a cost that depends on the part and on what changed at its edge, not on the mesh.

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "protocol/messages.hpp"
#include "protocol/replica.hpp"

namespace incise::protocol {

// Whether the corners' own bounding box meets `box`, bounds included.
bool meets(const Box& box, std::span<const Vec3> corners);

// The tetrahedra at each vertex of a whole mesh, to find those that change when a vertex moves: a linked list of corners
// (4 tetrahedron + place) for each vertex.
//
// Thread: one, at a time. Owns: its lists, 16 bytes a tetrahedron.
class TetIndex {
 public:
  // Of all of `mesh`. O(mesh).
  void load(const Replica& mesh);
  // Applies `delta`; `before` has not applied it yet. O(delta x tetrahedra at a vertex).
  void follow(const Replica& before, const Delta& delta);
  // Appends the tetrahedra that have `vertex`.
  void append_tets(std::uint32_t vertex, std::vector<std::uint32_t>& out) const;

 private:
  void link(std::uint32_t vertex, std::uint32_t corner);
  void unlink(std::uint32_t vertex, std::uint32_t corner);
  std::vector<std::uint32_t> first_, next_;  // by vertex, by corner; kNoId ends a list
};

// What one step, or several, changed in a mesh, without positions. A step of a cut names the vertices that it moved, which
// are few and may go far; a simulator moves all of them a little, so a deformation has one bound for all.
struct MeshChange {
  std::uint64_t base_revision = 0, revision = 0;
  std::vector<Step> steps;
  std::vector<std::uint32_t> tets;       // new, changed, removed or in another piece; in no order, may repeat
  std::vector<std::uint32_t> cut_moved;  // vertices that a cut moved; likewise
  bool deformed = false;                 // a simulator moved vertices...
  double travel_m = 0;                   // ... each by at most this along each axis
  std::uint32_t first_added = 0, first_new_tet = 0;
  std::vector<std::uint32_t> provenance_a, provenance_b;
  std::vector<double> provenance_t;
  std::uint32_t vertex_count = 0, live_tets = 0;
  std::uint64_t state_hash = 0;

  MeshChange() = default;
  // `before` has not applied `delta` yet. What Replica::follow_pieces() finds then is to be added to `tets`. O(delta).
  MeshChange(const Replica& before, const Delta& delta);
  // `next` follows on this. O(next).
  void append(const MeshChange& next);
  std::size_t bytes() const;
};

// The elements near the faces of a box: all that can enter or leave it while no vertex has moved farther than a margin. So
// a body that moves as a whole costs a box only what lies at its faces, and a look at the whole mesh every few steps (the
// neighbour lists with a skin of molecular dynamics: Verlet, Phys. Rev. 159, 98, 1967).
class BoxShell {
 public:
  // Whether ids() still has all such elements after vertices moved by up to `travel_m` more. If not, begin() and add() all.
  bool covers(double travel_m);
  // Starts again, with room for several steps like one of `travel_m`.
  void begin(const Box& box, double travel_m);
  // An element as it is now; kept where it may cross the box's faces. Without begin() nothing is kept.
  void add(std::uint32_t id, std::span<const Vec3> corners);
  // May repeat, and may have some that are gone.
  const std::vector<std::uint32_t>& ids() const { return ids_; }

 private:
  Box outer_, inner_;   // the box with the margin added and taken off
  double left_m_ = -1;  // how far vertices may still move; negative: nothing is known
  std::size_t compact_at_ = 0;
  std::vector<std::uint32_t> ids_;
};

}  // namespace incise::protocol
