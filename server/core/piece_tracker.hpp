#pragma once

#include <cstdint>
#include <vector>

#include "server/core/cutter.hpp"
#include "server/core/delta.hpp"
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
    claims_.reserve(mesh.tet_slots() + mesh.tet_slots() / 4 + 65536);
    claims_.resize(mesh.tet_slots(), {0, 0});
  }

  // Begins with the tetrahedra that the running step has touched.
  void begin();
  // Goes on until done (true) or the budget is spent (false).
  bool advance(WorkBudget& budget);
  // Lists in delta.pieces, by piece, the tetrahedra that this step has put into another piece than before, and the new
  // ones whose piece is not 0. The mesh's step must still run.
  void report(Delta& delta);

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

  TetMesh& mesh_;
  std::uint32_t next_piece_ = 1;
  std::uint32_t search_ = 0;  // serial of the running search
  struct Claim {
    std::uint32_t search, group;
  };
  std::vector<Claim> claims_;   // by tetrahedron: the search that came by, and its group
  std::vector<TetId> visited_;  // breadth first
  std::size_t next_ = 0, next_relabelled_ = 0;
  struct Group {
    std::uint32_t parent;
    std::uint32_t waiting;  // tetrahedra of the group in visited_[next_...]
    std::uint32_t piece;    // that it began in
    std::uint32_t fresh;    // the new piece that it turned out to be; 0: none
  };
  std::vector<Group> groups_;
  std::vector<std::uint32_t> searching_;  // by piece: its groups that still have somewhere to go
  std::uint32_t undecided_ = 0;           // pieces with more than one of them
  struct Change {
    std::uint32_t piece;
    TetId tet;
  };
  std::vector<Change> changed_;
  std::vector<TetId> scratch_;
};

}  // namespace incise::core
