#pragma once

#include <utility>
#include <vector>

#include "server/core/cut/conforming/films.hpp"

namespace incise::core {

// Tetrahedra that the sweep would cut off on all sides, though no part of the tissue lies there, stay with their
// neighbours: some that hang together by ragged faces, the tip of a toe, or a sheet of them between two layers of the surface. Takes faces out
// of those that are about to open (TetMarks::pending).
class Islands {
 public:
  explicit Islands(CutContext& cut)
      : cut_(cut), mesh_(cut.mesh), inland_(cut.workspace), seen_(cut.workspace), films_(cut) {
    members_.reserve(tolerance::kMaxSheetIsland + 4);
  }

  void begin() {
    inland_.begin();
    joined_ = false;
    films_.begin();
  }
  // Looks at what lies behind a face that is about to open.
  void spare(HalfFace side);
  // Whether something has stayed with a neighbour since this was last asked: that may have become an island by it, and all faces are to be looked at again.
  bool look_again() {
    inland_.begin();
    return std::exchange(joined_, false);
  }

 private:
  bool is_island(TetId first);
  bool is_tip(const Extent& extent) const;
  bool join_larger_side();
  void reach_around(TetId first);
  bool is_above(HalfFace h) const;
  bool stands_clear(HalfFace h) const;
  bool is_ragged(HalfFace h) const;
  bool is_thin(TetId t) const;
  bool pending(TetId t, int f) const { return cut_.is_pending(half_face(t, f)); }

  CutContext& cut_;
  const TetMesh& mesh_;
  TetPass inland_;  // looked at from another face, and found to be no island
  TetPass seen_;    // the members, then what is around them
  Films films_;
  bool joined_ = false;
  std::vector<TetId> members_, around_;
};

}  // namespace incise::core
