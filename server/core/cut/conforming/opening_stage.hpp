#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "server/core/cut/conforming/active_set.hpp"
#include "server/core/cut/conforming/islands.hpp"
#include "server/core/cut/conforming/mesh_editor.hpp"

namespace incise::core {

// Opens faces: exactly those where the line between the reference points of the two tetrahedra crosses the surface, islands
// apart. A tetrahedron all of whose faces are decided is active no longer.
class OpeningStage {
 public:
  OpeningStage(CutContext& cut, ActiveSet& active, MeshEditor& editor)
      : cut_(cut),
        mesh_(cut.mesh),
        active_(active),
        editor_(editor),
        selected_(cut.workspace),
        islands_(cut) {}

  // The last scan of the active set still holds. `may_refine`: where faces would be chords of a bend, splits them instead of opening any.
  void begin(bool may_refine);
  // True: done; false: the budget is spent, or more is to do.
  bool advance(WorkBudget& budget);
  // It has split faces and opened none: all is to be verified again.
  bool refined() const { return phase_ == Phase::kRefine; }
  // What has opened: both sides of each face.
  std::span<const HalfFace> opened() const { return opened_; }

 private:
  enum class Phase { kSelect, kRefine, kSpare, kOpen };

  bool select(WorkBudget& budget);
  bool select_faces(TetId t);
  unsigned may_separate(TetId t) const;
  // Where the surface crosses the way from one side of a face to the other: close by the face's middle, farther from it, nowhere.
  enum class Way { kCrossedHere, kCrossedAside, kFree };
  Way separates(HalfFace h) const;
  Way way_along(const std::array<Vec3, 4>& way) const;
  bool was_swept_across(const Vec3& middle, const Vec3& from, const Vec3& to) const;
  bool lies_in_what_was_swept(HalfFace h) const;
  bool is_chord(HalfFace h) const;
  bool is_alone(const Vec3& p) const;
  bool refine(WorkBudget& budget);
  void split_chord(const std::array<VertexId, 3>& face);
  bool spare_islands(WorkBudget& budget);
  bool open(WorkBudget& budget);

  CutContext& cut_;
  const TetMesh& mesh_;
  ActiveSet& active_;
  MeshEditor& editor_;

  Phase phase_ = Phase::kSelect;
  std::size_t next_ = 0;  // how far the phase is, in active_ or in faces_
  std::size_t kept_ = 0;  // of active_
  TetPass selected_;      // whose faces have been looked at
  Islands islands_;
  bool may_refine_ = false;
  std::vector<std::array<VertexId, 3>> chords_;  // of faces to open
  std::vector<HalfFace> faces_;                  // to open
  std::vector<HalfFace> opened_;                 // both sides of each
};

}  // namespace incise::core
