#pragma once

#include <cstdint>
#include <vector>

#include "server/core/mesh/delta.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/tet_clusters.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// Finds out what a step has cut off. From the tetrahedra at the new cut faces, searches spread through the mesh at the
// same pace; searches that meet merge into a group. A group that has nothing left to visit, while another of the
// same piece goes on, is a separate piece. Of the parts of a piece, the largest keeps its id. The searches visit clusters and
// blocks of them (TetClusters), which also hold which piece they are in. So the cost is that of the step, of what earlier steps have left around it
// and a thousandth of the tetrahedra of the smaller side; it is next to nothing if the two sides of a cut are still connected
// around its front.
class PieceTracker {
 public:
  // O(mesh). Later steps only add the elements that are new.
  explicit PieceTracker(const TetMesh& mesh);
  // The same; the clusters have been formed, of a mesh that this one is a copy of.
  PieceTracker(const TetMesh& mesh, const TetClusters& clusters);

  // Begins with the tetrahedra that the running step has touched.
  void begin();
  // Goes on until done (true) or the budget is spent (false). Names in delta.pieces (the same delta each time) the pieces that this
  // step has made, and those whose tetrahedron it has taken. The mesh's step must still run.
  bool advance(WorkBudget& budget, Delta& delta);

  // Its members that do not follow from the mesh, and the clusters, which decide in which order parts end.
  void archive(Archive& io);

  const TetClusters& clusters() const { return clusters_; }
  // Pieces there have been so far; ids run below it.
  std::uint32_t pieces() const { return next_piece_; }
  // Which piece a living tetrahedron is in, between two steps. Not part of the state that the hash names.
  std::uint32_t piece(TetId t) const { return clusters_.piece(t); }
  // Those that there are but 0. O(pieces()).
  std::vector<Delta::Piece> named() const;

 private:
  std::uint32_t find(std::uint32_t group) {
    while (groups_[group].parent != group) {
      groups_[group].parent = groups_[groups_[group].parent].parent;
      group = groups_[group].parent;
    }
    return group;
  }
  using NodeId = TetClusters::NodeId;
  struct Search;
  void claim(NodeId node, std::uint32_t group);
  void meet(NodeId node, std::uint32_t group);
  void merge(std::uint32_t other, std::uint32_t group);
  void settle(std::uint32_t piece);
  bool has_other_neighbors(TetId t) const;
  Search& search_of(std::uint32_t piece);
  bool count(WorkBudget& budget);
  bool loosen(WorkBudget& budget);
  bool form(WorkBudget& budget);
  bool seed(WorkBudget& budget);
  bool search(WorkBudget& budget);
  bool relabel(WorkBudget& budget);
  bool find_names(WorkBudget& budget);
  void name(Delta& delta);

  const TetMesh& mesh_;
  std::uint32_t next_piece_ = 1;

  TetClusters clusters_;
  std::vector<TetClusters::Loose> loose_;  // this step has dissolved their clusters, or they are new

  std::uint32_t search_ = 0;  // serial of the running search
  enum class Phase { kCount, kLoosen, kForm, kSeed, kSearch, kRelabel, kFindNames };
  Phase phase_ = Phase::kCount;
  struct Visited {
    NodeId node;
    std::uint32_t next;  // that waits in the same group, into visited_
  };
  std::vector<Visited> visited_;
  std::size_t next_ = 0;  // how far the phase is
  struct Group {
    std::uint32_t parent;
    std::uint32_t first, last;  // that wait, breadth first, into visited_
    std::uint32_t piece;        // that it began in
    TetId tet;                  // with which it began
    std::uint32_t fresh;        // the new piece that it turned out to be; 0: none
    std::uint32_t tets;         // that it has claimed
    std::int32_t credit;        // tetrahedra that it may visit in its turn
  };
  void end_group(std::uint32_t group);
  std::vector<Group> groups_;
  std::vector<std::uint32_t> ring_;  // groups in turn, and some that are done
  std::size_t turn_ = 0;
  std::int32_t rounds_ = 0;
  std::vector<std::uint32_t> piece_tets_;  // by piece: how many it has
  std::vector<TetId> names_;               // by piece: one of them; kNone for piece 0
  struct Search {
    std::uint32_t serial = 0;       // of the search that began this
    std::uint32_t groups = 0;       // that still have something to visit
    std::uint32_t largest = kNone;  // of the groups that are pieces of their own
    std::uint32_t cut_off = 0;      // tetrahedra of all of these
    bool finishing = false;  // what is left may be less than the largest of them: it is visited to its end
  };
  std::vector<Search> searches_;         // by piece
  std::vector<std::uint32_t> searched_;  // pieces
  std::uint32_t undecided_ = 0;          // pieces with more than one group, or finishing
  std::vector<std::uint32_t> nameless_;  // pieces that need another name
  std::vector<std::uint32_t> named_;     // pieces to be told of
};

}  // namespace incise::core
