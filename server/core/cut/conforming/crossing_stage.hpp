#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "server/core/cut/conforming/crossings.hpp"
#include "server/core/cut/conforming/mesh_editor.hpp"
#include "server/core/cut/conforming/placement.hpp"
#include "server/core/util/run_sorter.hpp"

namespace incise::core {

// Deals with crossings that need not wait for the blade any more, nearest first: the nearer end of the edge is snapped onto the
// surface, else the farther end, else the edge is split. What a first pass cannot do well waits for a second one, when its
// neighbours have been dealt with. Where only needles would be left, what is near the crossing stands for it.
class CrossingStage {
 public:
  CrossingStage(CutContext& cut, Crossings& crossings, MeshEditor& editor)
      : cut_(cut), mesh_(cut.mesh), crossings_(crossings), editor_(editor), places_(cut) {}

  // `round`: 0 for what the search has found, then for what verification has found.
  void begin(int round);
  // True: done; false: the budget is spent, or more is to do.
  bool advance(WorkBudget& budget);

 private:
  bool order(WorkBudget& budget);
  void fetch_ahead(std::size_t at);
  void handle(std::uint32_t index);
  bool still_crosses(Crossing& crossing);
  bool snap_well(const Crossing& crossing, const Vec3& at);
  bool tears_film(int end, const Vec3& target);
  void make_do(const Crossing& crossing);
  bool take_as_met(const Crossing& crossing);
  void split(const Crossing& crossing);

  CutContext& cut_;
  const TetMesh& mesh_;
  Crossings& crossings_;
  MeshEditor& editor_;
  PlaceFinder places_;

  // Nearest crossing first.
  struct Key {
    double nearness;
    VertexId a, b;
    std::uint32_t index;
    bool operator<(const Key& other) const {
      if (nearness != other.nearness) return nearness < other.nearness;
      if (a != other.a) return a < other.a;
      return b != other.b ? b < other.b : index < other.index;
    }
  };
  RunSorter<Key> order_;
  std::size_t next_ordered_ = 0;  // in crossings_, until all are listed
  bool sealed_ = false;           // all are listed
  bool ordered_ = false;          // and in in_turn_
  int round_ = 0;
  int pass_ = 0;
  std::vector<std::uint32_t> in_turn_;  // that this pass works on
  std::size_t next_in_turn_ = 0;
  std::vector<std::uint32_t> retry_;  // that the next one will

  // The crossing at work: its ends, the nearer first, their stars, and where they would go.
  VertexId ends_[2]{};
  VertexStar stars_[2];
  Placement best_[2];
  std::vector<TetId> flat_;  // scratch
};

}  // namespace incise::core
