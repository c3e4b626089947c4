#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "server/core/cut/cut_workspace.hpp"
#include "server/core/cut/cutter.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/grid_follower.hpp"
#include "server/core/session/late_vertices.hpp"
#include "server/core/session/step_tets.hpp"
#include "server/core/session/target_positions.hpp"
#include "server/core/session/vertex_positions.hpp"

namespace incise::core {

// Moves vertices to the positions that a host simulation has sent, all at once, after checking that the mesh stays valid:
//
//   gather   what cuts have made since the last step, or everything before the first one.
//   lead     where those go that were cut or made since the simulation's revision: with what they hang on (LateVertices).
//   take     which vertices move. Those at a blade stay, or go all together: the cut under way relies on how they lie to each other, so
//            the tissue clings to the blade until it has passed.
//   check    tetrahedra that would invert, become flat (thinner than a thousandth of h^3, or of their longest edge's cube; what is flat already may
//            lose half) or be stretched (longer than 16 mean edge lengths, and than four times what they are at rest). Their vertices go half
//            the way, or stay if that is still too far; this repeats until no tetrahedron is wrong. Each vertex is held back at most twice, so
//            this ends.
//   settle   the change of the state hash; then the boundary grid follows (GridFollower). Both are noted as vertices are taken, and
//            corrected for those that give way.
//
// Nothing changes before commit(), and the budget is checked in between. The cost depends on the vertices that move only.
class VertexMover {
 public:
  // What clings to a blade is where the simulation wants it if it is so near to that, and does not follow by less.
  static constexpr double kSamePlace_h = 5e-3;

  // All must outlive this. `stays_valid`: every tetrahedron is right-handed; else those that are flat or inside out, as the policy `croll` leaves them, hold
  // nothing back.
  VertexMover(TetMesh& mesh, CutWorkspace& workspace, const TetClusters& clusters, bool stays_valid);

  // `positions` must live until commit(), and `clinging`, the vertices at blades, ascending. `known`: what gives way,
  // from another session that was in the same state: if most vertices move, nothing is checked. It must live until commit().
  void begin(const VertexPositions& positions, std::span<const VertexPlace> clinging,
             const std::vector<GaveWay>* known = nullptr);
  // The same once more, where what clings has to stay.
  void begin_again(const VertexPositions& positions, std::span<const VertexPlace> clinging);
  // Where these positions want a vertex; null: they do not say so, or did not know where it is.
  const Vec3* wanted_place(const VertexPositions& positions, VertexId v) const {
    return late_.wanted_place(positions, v);
  }
  // Works until all is ready (true) or the budget is spent (false).
  bool advance(WorkBudget& budget);
  // Where a vertex lies once it commits; it must be ready.
  const Vec3& place_after(VertexId v) const { return target_[v]; }
  std::span<const Vec3> places_after() const { return target_.by_vertex(); }
  // Ready, but what clings would not lie as it has to, since tetrahedra would invert. Then commit() must not follow, but begin_again().
  bool clinging_gives_way() const { return clinging_gives_way_; }
  // Moves the vertices. Fills the mesh part of `delta`.
  void commit(Delta& delta);

  // Records the vertices that a cut has moved or made in delta.revision: simulations do not know these yet.
  void note_cut(const Delta& delta);

  void archive(Archive& io);

  // So many vertices move when it commits.
  std::size_t moving() const { return moved_.size(); }
  // What gave way in the last step, ascending.
  const std::vector<GaveWay>& gave_way() const { return gave_way_; }
  // Tetrahedra that were looked at, ever.
  std::uint64_t checked() const { return checked_; }

 private:
  enum class Phase {
    kGather,
    kLead,
    kTake,
    kLook,
    kCheck,
    kYield,
    kSettle,
    kLeaveOut,
    kHash,
    kFollow,
    kReady
  };
  // How much of its way a vertex goes.
  static constexpr std::uint8_t kStays = 0, kHalf = 1, kFull = 2;

  void gather(WorkBudget& budget);
  void take(WorkBudget& budget);
  bool is_plain(std::size_t first, std::size_t stop);
  void take_plain(std::size_t first, std::size_t stop);
  bool may_move(VertexId v, const Vec3& to);
  void want(VertexId v, const Vec3& to);
  void take_before(VertexId v);
  void take_clinging(const Vec3* wanted);
  void take_late();
  void look(WorkBudget& budget);
  void look_around(VertexId v);
  void check(WorkBudget& budget);
  void check_all(WorkBudget& budget);
  void check_listed(WorkBudget& budget);
  void checked_round();
  void check_tet(const std::array<VertexId, 4>& v);
  bool stretches(const std::array<VertexId, 4>& v) const;
  bool flattens(const std::array<VertexId, 4>& v) const;
  void yield(WorkBudget& budget);
  void settle(WorkBudget& budget);
  void take_known();
  void begin_settling();
  void give_way(const GaveWay& gave);
  bool leave_out(WorkBudget& budget);
  void begin_following();
  void note_moved(std::size_t first);
  // By what the hash changes when these go there; where moves_most_, without what they were.
  std::uint64_t hash_of_move(std::span<const VertexId> vertices, std::span<const Vec3> to) const;
  bool leave_out_of_hash(WorkBudget& budget);
  bool wanted(VertexId v) const { return wanted_[v] == serial_; }
  GridFollower::Step grid_step() {
    return {moved_, target_.by_vertex(), boundary_, all_tets_ ? &tets_ : nullptr};
  }

  TetMesh& mesh_;
  CutWorkspace& workspace_;
  const bool stays_valid_;
  LateVertices late_;

  const VertexPositions* positions_ = nullptr;
  std::span<const VertexPlace> clinging_;                        // in this step
  std::size_t next_clinging_ = 0, next_late_ = 0;                // that are to be taken
  VertexId next_given_ = 0;                                      // no vertex before this is one of these
  bool clinging_gives_way_ = false, clinging_gave_way_ = false;  // now, and before it was begun again
  Phase phase_ = Phase::kReady;
  std::size_t next_ = 0;
  std::uint32_t serial_ = 0;
  std::vector<std::uint32_t> wanted_;     // by vertex: the step that wants to move it
  std::vector<std::uint32_t> gives_way_;  // by vertex: the pass that found that it goes too far
  TetPass pass_;                          // through tetrahedra: looks at each once
  std::vector<std::uint8_t> reach_;       // by vertex, while it is wanted
  TargetPositions target_;  // where each vertex will lie, as far as is known; where it is, between two steps
  StepTets tets_;
  double surely_thick_ = 0;   // six volumes, m^3: no tetrahedron that has them is flat
  bool all_tets_ = false;     // the first round looks at all instead of at stars
  bool first_round_ = false;  // it meets every tetrahedron at a vertex that is wanted
  const std::vector<GaveWay>* known_ = nullptr;
  std::uint64_t checked_ = 0;
  std::vector<TetId> to_check_;
  std::vector<TetId>
      boundary_;  // of those of the first round: the ones on the boundary, where it does not look at all
  std::vector<VertexId> too_far_;
  std::uint32_t passed_over_ = 0;
  std::vector<VertexId> held_;
  std::size_t held_at_blades_ = 0;  // the first of these
  std::vector<GaveWay> gave_way_;
  bool any_stay_ = false;        // of these
  std::size_t left_in_ = 0;      // of moved_, so far, when some are left out
  std::vector<VertexId> moved_;  // wanted, ascending; in the end without those that stay
  std::vector<Vec3> moved_positions_;
  std::uint64_t hash_change_ = 0;
  // The vertices' part of the state hash, of those in target_, between two steps: what most vertices were need not be hashed
  // where this is known.
  std::uint64_t vertices_hash_ = 0;
  bool moves_most_ = false;        // the step names most vertices
  std::size_t next_in_moved_ = 0;  // while those that do not move are hashed
  GridFollower grid_;
  std::vector<Corner> star_;
};

}  // namespace incise::core
