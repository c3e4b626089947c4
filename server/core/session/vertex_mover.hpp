#pragma once

#include <cstdint>
#include <vector>

#include "server/core/cut/cut_workspace.hpp"
#include "server/core/cut/cutter.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/grid_follower.hpp"
#include "server/core/session/target_positions.hpp"
#include "server/core/session/vertex_positions.hpp"

namespace incise::core {

// Moves vertices to the positions that a host simulation has sent, all at once, after checking that the mesh stays valid:
//
//   take     which vertices move: not those that were cut or made since the simulation's revision (it does not know their
//            present state), nor those at a blade: the cut under way relies on the places it has given them, so
//            the tissue clings to the blade until it has passed.
//   check    tetrahedra that would invert or become flat (thinner than a thousandth of h^3, unless they were before and
//            get no thinner). Their vertices go half the way, or stay if that is still too far; this repeats until no
//            tetrahedron is wrong. Each vertex is held back at most twice, so this ends.
//   settle   the change of the state hash; then the boundary grid follows (GridFollower).
//
// Nothing changes before commit(), and the budget is checked in between. The cost depends on the vertices that move only.
class VertexMover {
 public:
  // Both must outlive this.
  VertexMover(TetMesh& mesh, CutWorkspace& workspace);

  // `positions` must live until commit(). `clinging`: the vertices at blades, repetitions allowed.
  void begin(const VertexPositions& positions, const std::vector<VertexId>& clinging);
  // Works until all is ready (true) or the budget is spent (false).
  bool advance(WorkBudget& budget);
  // Moves the vertices. Fills the mesh part of `delta`.
  void commit(Delta& delta);

  // Records the vertices that a cut has moved or made in delta.revision: simulations do not know these yet.
  void note_cut(const Delta& delta);

  void archive(Archive& io);

 private:
  enum class Phase { kTake, kLook, kCheck, kYield, kSettle, kFollow, kReady };
  // How much of its way a vertex goes; between the two, half.
  static constexpr std::uint8_t kStays = 0, kFull = 2;

  void take(WorkBudget& budget);
  void look(WorkBudget& budget);
  void look_around(VertexId v);
  void check(WorkBudget& budget);
  void check_tet(TetId t);
  void yield(WorkBudget& budget);
  void settle(WorkBudget& budget);
  bool wanted(VertexId v) const { return wanted_[v] == serial_; }
  GridFollower::Step grid_step() const { return {moved_, moved_positions_, target_.by_vertex(), boundary_}; }

  TetMesh& mesh_;
  CutWorkspace& workspace_;
  std::vector<std::uint64_t> known_since_;  // by vertex: the revision of the last cut that moved or made it

  const VertexPositions* positions_ = nullptr;
  Phase phase_ = Phase::kReady;
  std::size_t next_ = 0;
  std::uint32_t serial_ = 0;
  std::vector<std::uint32_t> wanted_;     // by vertex: the step that wants to move it
  std::vector<std::uint32_t> clinging_;   // by vertex: the step in which it clings to a blade
  std::vector<std::uint32_t> gives_way_;  // by vertex: the pass that found that it goes too far
  TetPass pass_;                          // through tetrahedra: looks at each once
  std::vector<std::uint8_t> reach_;       // by vertex, while it is wanted
  TargetPositions target_;  // where each vertex will lie, as far as is known; where it is, between two steps
  std::vector<VertexId> moving_;  // wanted, ascending
  double surely_thick_ = 0;       // six volumes, m^3: no tetrahedron that has them is flat
  bool all_tets_ = false;         // the first round looks at all instead of at stars
  bool first_round_ = false;      // it meets every tetrahedron at a vertex that is wanted
  std::vector<TetId> to_check_;
  std::vector<GridFollower::BoundaryTet> boundary_;  // of those: the ones on the boundary
  std::vector<VertexId> too_far_;
  std::uint32_t passed_over_ = 0;
  std::vector<VertexId> held_;
  std::vector<VertexId> moved_;
  std::vector<Vec3> moved_positions_;
  std::uint64_t hash_change_ = 0;
  GridFollower grid_;
  std::vector<Corner> star_;
};

}  // namespace incise::core
