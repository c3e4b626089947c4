#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "server/core/cut/conforming/tissue_grid.hpp"

namespace incise::core {

// Finds what still holds together two parts that were swept apart, where it takes several faces to do so: in elements as large as the blade is long, they lie
// beside the surface, and some have no edge at the boundary. On a grid it sees which tissue the surfaces part around a place; between the
// tetrahedra that lie deep in the parts it looks for the faces that part them, as few and as near to the surfaces as can be: a minimum cut (Ford and
// Fulkerson 1956).
class BridgeFinder {
 public:
  BridgeFinder(CutContext& cut, TissueGrid& grid)
      : cut_(cut), mesh_(cut.mesh), grid_(grid), pass_(cut.workspace) {}

  // Begins to look around h, an interior face.
  void begin(HalfFace h);
  // True: done. The mesh must stay as it is until then. Some 0.4 ms in all, 1.5 where two parts are near, 5 where they stay apart; a step takes some 0.02 ms, but where much was swept.
  bool advance(WorkBudget& budget);
  // What the next look will cost: so much more that it may be for the next part of the batch. 0: it has begun.
  std::size_t cost_ahead() const {
    if (stage_ != Stage::kLookFarther) return 0;
    const double points = 2 * tolerance::kBridgeReach_h[look_ + 1] / tolerance::kBridgeStep_h + 3;
    return cost::kPartNeckPoint * static_cast<std::size_t>(points * points * points);
  }
  void stop() { go(Stage::kIdle); }
  bool is_looking() const { return stage_ != Stage::kIdle; }
  // How far it has looked around the face: as far as kBridgeReach_h[that].
  std::size_t look() const { return look_; }
  // What has to open, one side of each face; nothing, as a rule.
  std::span<const HalfFace> faces() const { return faces_; }

 private:
  enum class Stage { kIdle, kLookFarther, kFill, kBlock, kUnite, kFindClear, kFindDeep, kUniteInSkin, kPart };
  // What the surfaces part from all else in the box.
  struct Part {
    std::uint32_t root;           // the first of its points
    std::size_t deep;             // points that are
    std::uint32_t skin_root = 0;  // the first point of all that the skin alone does not part from it
  };
  // From a tetrahedron through one of its faces: as numbers in tets_.
  struct Way {
    std::uint32_t to = kNothing;
    std::uint32_t back = 0;  // the same, as the other one has it
    int capacity = 0, flow = 0;
  };
  static constexpr std::uint32_t kNothing = ~0u;
  static constexpr int kNeverOpens = 1 << 20;     // a capacity
  static constexpr std::size_t kMostParts = 255;  // labels are bytes

  static constexpr std::size_t kChunk = 2048, kTetChunk = 16;  // points and tetrahedra in a step

  void go(Stage stage) {
    stage_ = stage;
    next_ = 0;
  }
  void look_around(std::size_t look);
  bool is_last_look() const { return look_ + 1 == tolerance::kBridgeReach_h.size(); }
  void step();
  void fill(std::size_t end);
  static std::uint32_t root_of(std::uint32_t at, std::vector<std::uint32_t>& roots);
  void unite(std::size_t end, unsigned blocked_by, std::vector<std::uint32_t>& roots);
  void find_clear(std::size_t end);
  void find_deep(std::size_t end);
  bool is_deep(std::size_t at) const;
  void list_parts();
  void part_all();
  void list_ways();
  bool is_inside(TetId t) const;
  void label_tets();
  void list_capacities();
  void part_from_others(std::uint8_t label);
  std::uint32_t reach_others(std::uint8_t label);
  void close_way(HalfFace h);
  HalfFace face_of_way(std::size_t way) const { return half_face(tets_[way / 4], static_cast<int>(way % 4)); }

  CutContext& cut_;
  const TetMesh& mesh_;
  TissueGrid& grid_;
  TetPass pass_;

  HalfFace face_ = kNone;
  std::size_t look_ = 0;  // which of kBridgeReach_h
  Box near_;              // what the first look saw
  Stage stage_ = Stage::kIdle;
  std::size_t next_ = 0;     // how far the stage is
  std::vector<TetId> tets_;  // in the box; then those that are so as a whole, ascending
  std::vector<std::uint32_t> roots_,
      skin_roots_;                    // by point: root_of() is the first one that is connected with it
  std::vector<std::uint8_t> clear_;   // by point: 1, no surface beside it; 2, it is deep
  std::vector<std::uint32_t> deep_;   // by root: how many points count
  std::vector<Part> parts_;           // with enough of these, the largest first
  std::vector<std::uint8_t> labels_;  // by tetrahedron: 1 + the part that it lies deep in; 0: none
  std::vector<Way> ways_;             // 4 for each tetrahedron
  std::vector<std::pair<VertexId, double>> off_m2_;  // from what was swept, squared; ascending
  std::vector<std::uint8_t> reached_;                // by tetrahedron
  std::vector<std::uint32_t> through_;               // by tetrahedron: the way by which it was reached
  std::vector<std::uint32_t> queue_;
  std::vector<HalfFace> faces_;
};

}  // namespace incise::core
