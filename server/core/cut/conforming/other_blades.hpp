#pragma once

#include <vector>

#include "server/core/cut/cut_workspace.hpp"
#include "server/core/geometry/vec3.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

struct CutContext;

// What a blade has to know of the others that cut the same mesh at the same time, and they of it. A blade is busy, between its batches, while
// it has swept what is not parted yet: all near its front. What others change there it looks at again in its next batch; what they
// would close or part beyond their own sweep, near by, they leave to it.
class OtherBlades {
 public:
  OtherBlades(CutContext& cut, CutWorkspace& workspace);
  OtherBlades(const OtherBlades&) = delete;

  // Whether there has been no other one in this mesh.
  bool are_none() const { return blades_.size() == 1; }
  // t was made or changed.
  void offer(TetId t) const {
    if (!are_none()) offer_to_all(t);
  }
  // Whether one is about to part what is near p.
  bool are_near(const Vec3& p) const { return near(p) != nullptr; }
  // Leaves it to one that is near a face what becomes of it; false: none is.
  bool leave(HalfFace face) const;

  // Of this blade itself: a stroke begins, or a batch has ended and it has swept what is not parted yet, or not.
  void begin_stroke() {
    offered_.clear();
    left_.clear();
  }
  void end_batch(bool is_busy);
  // What others have changed near it since its last batch: some of it may be gone.
  std::vector<TetId>& offered() { return offered_; }
  // Faces that they have left to it.
  std::vector<HalfFace>& left() { return left_; }

  void archive(Archive& io, bool is_busy);

 private:
  template <class Visit>
  void for_each(Visit visit) const;
  CutContext* near(const Vec3& p) const;
  void offer_to_all(TetId t) const;

  CutContext& cut_;
  std::vector<CutContext*>& blades_;  // all of the mesh
  bool is_busy_ = false;
  std::vector<TetId> offered_;  // each once, when a batch has ended
  std::vector<HalfFace> left_;
};

}  // namespace incise::core
