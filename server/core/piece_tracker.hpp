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
// same piece still has, has found a piece of its own. Of the parts of a piece, the largest keeps its id. So it costs what
// the smaller side holds (times two), and next to nothing where the two sides of a cut still hang together around its
// front.
//
// What no cut has touched yet is passed in one go, by clusters of some 32 tetrahedra that were formed at load. A step
// that touches one of its tetrahedra dissolves a cluster for good.
class PieceTracker {
 public:
  // O(mesh): later steps only add what the mesh has grown by.
  explicit PieceTracker(TetMesh& mesh);

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

  // A place of the search: a loose tetrahedron, or a cluster, which has the highest bit set.
  using Place = std::uint32_t;
  static constexpr Place kClusterBit = 1u << 31;

  std::uint32_t find(std::uint32_t group) {
    while (groups_[group].parent != group) {
      groups_[group].parent = groups_[groups_[group].parent].parent;
      group = groups_[group].parent;
    }
    return group;
  }
  Place place_of(TetId t) const { return cluster_of_[t] == kNone ? t : cluster_of_[t] | kClusterBit; }
  std::uint32_t size_of(Place place) const {
    const std::uint32_t c = place & ~kClusterBit;
    return place & kClusterBit ? clusters_[c + 1].members - clusters_[c].members : 1;
  }
  void form_clusters();
  void index_clusters();
  void dissolve(std::uint32_t cluster);
  struct Claim {
    std::uint32_t search, group;
  };
  Claim& claim_of(Place place) {
    return place & kClusterBit ? cluster_claims_[place & ~kClusterBit] : claims_[place];
  }
  void claim(Place place, std::uint32_t group);
  void meet(Place place, std::uint32_t group);
  std::int64_t expand(Place place, std::uint32_t group);
  void settle(std::uint32_t piece);
  bool has_other_neighbors(TetId t) const;
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

  std::vector<std::uint32_t> cluster_of_;  // by tetrahedron; kNone: loose
  struct Cluster {
    std::uint32_t members, links;  // where its own begin; the next one's begin where they end
    bool whole;
  };
  std::vector<Cluster> clusters_;     // and one more, where the last one's end
  std::vector<TetId> members_;        // ascending within each cluster
  std::vector<std::uint32_t> links_;  // clusters that share a face with it; kNone: loose tetrahedra do

  std::uint32_t search_ = 0;  // serial of the running search
  // By tetrahedron and by cluster: the search that came by, and its group.
  std::vector<Claim> claims_, cluster_claims_;
  enum class Phase { kSeed, kSearch, kRelabel, kScan, kNew, kList };
  Phase phase_ = Phase::kSeed;
  struct Visited {
    Place place;
    std::uint32_t next;  // that waits in the same group, into visited_
  };
  std::vector<Visited> visited_;
  std::size_t next_seed_ = 0, next_relabelled_ = 0;
  struct Group {
    std::uint32_t parent;
    std::uint32_t first, last;  // that wait, breadth first, into visited_
    std::uint32_t piece;        // that it began in
    std::uint32_t fresh;        // the new piece that it turned out to be; 0: none
    std::uint32_t tets;         // that it has claimed
    std::int32_t credit;        // tetrahedra that it may visit in its turn
  };
  Place take(Group& group);
  void end_group(std::uint32_t group);
  std::vector<Group> groups_;
  std::vector<std::uint32_t> ring_;  // groups in turn, and some that are done
  std::size_t turn_ = 0;
  std::int32_t rounds_ = 0;
  std::vector<std::uint32_t> piece_tets_;  // by piece: how many it has
  struct Search {
    std::uint32_t groups = 0;       // that still have somewhere to go
    std::uint32_t largest = kNone;  // of the groups that are pieces of their own
    std::uint32_t cut_off = 0;      // tetrahedra of all of these
    bool finishing = false;  // what is left may be less than the largest of them: it is visited to its end
  };
  std::vector<Search> searches_;  // by piece
  std::uint32_t undecided_ = 0;   // pieces with more than one group, or finishing
  std::uint32_t pieces_before_ = 1;
  RunSorter<std::uint64_t> changed_;  // piece << 32 | tetrahedron
};

}  // namespace incise::core
