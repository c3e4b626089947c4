#pragma once

#include <cstdint>
#include <vector>

#include "server/core/cutter.hpp"
#include "server/core/delta.hpp"
#include "server/core/room.hpp"
#include "server/core/run_sorter.hpp"
#include "server/core/tet_mesh.hpp"

namespace incise::core {

// Finds out what a step has cut off. From the tetrahedra at the new cut faces, searches spread through the mesh at the
// same pace; searches that meet become one. A group of searches that has nowhere left to go, while another of the
// same piece still has, has found a piece of its own: the smaller one. So it costs what the smaller side holds (times
// two), and next to nothing where the two sides of a cut still hang together around its front.
class PieceTracker {
 public:
  // O(mesh): later steps only add what the mesh has grown by.
  explicit PieceTracker(TetMesh& mesh) : mesh_(mesh) {
    claims_.reserve(room_for(mesh.tet_slots()));
    claims_.resize(mesh.tet_slots(), {0, 0});
  }

  // Begins with the tetrahedra that the running step has touched.
  void begin();
  // Goes on until done (true) or the budget is spent (false). Lists in delta.pieces (the same delta each time), by piece,
  // the tetrahedra that this step has put into another piece than before, and the new ones whose piece is not 0. The
  // mesh's step must still run.
  bool advance(WorkBudget& budget, Delta& delta);

  // Pieces there have been so far; ids run below it.
  std::uint32_t pieces() const { return next_piece_; }

 private:
  friend struct SessionFields;  // session_state.cpp

  std::uint32_t find(std::uint32_t group) {
    while (groups_[group].parent != group) {
      groups_[group].parent = groups_[groups_[group].parent].parent;
      group = groups_[group].parent;
    }
    return group;
  }
  void claim(TetId t, std::uint32_t group);
  void fetch_ahead() const;
  bool seed(WorkBudget& budget);
  bool search(WorkBudget& budget);
  bool relabel(WorkBudget& budget);
  bool relabel_by_scan(WorkBudget& budget, Delta& delta);
  bool list_new(WorkBudget& budget);
  bool list(WorkBudget& budget, Delta& delta);
  std::uint32_t fresh_piece(TetId t);
  static void append(Delta& delta, std::uint32_t piece, TetId t);

  TetMesh& mesh_;
  std::uint32_t next_piece_ = 1;
  std::uint32_t search_ = 0;  // serial of the running search
  struct Claim {
    std::uint32_t search, group;
  };
  std::vector<Claim> claims_;   // by tetrahedron: the search that came by, and its group
  std::vector<TetId> visited_;  // breadth first
  enum class Phase { kSeed, kSearch, kRelabel, kScan, kNew, kList };
  Phase phase_ = Phase::kSeed;
  std::size_t next_seed_ = 0, next_ = 0, next_relabelled_ = 0;
  struct Group {
    std::uint32_t parent;
    std::uint32_t waiting;  // tetrahedra of the group in visited_[next_...]
    std::uint32_t piece;    // that it began in
    std::uint32_t fresh;    // the new piece that it turned out to be; 0: none
  };
  std::vector<Group> groups_;
  std::vector<std::uint32_t> searching_;  // by piece: its groups that still have somewhere to go
  std::uint32_t undecided_ = 0;           // pieces with more than one of them
  RunSorter<std::uint64_t> changed_;      // piece << 32 | tetrahedron
};

}  // namespace incise::core
