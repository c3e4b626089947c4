#pragma once

#include <cstddef>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"
#include "server/core/stroke/stroke_builder.hpp"

namespace incise::core {

// Continues a sweep that begins or ends near an older cut, or before the body's boundary, until it is through: what is nearer
// than a quarter of an element is one.
class JoiningStage {
 public:
  explicit JoiningStage(CutContext& cut) : cut_(cut), mesh_(cut.mesh) {}

  void clear() { direction_ = {}; }  // a new stroke
  void begin(const Batch& batch);
  // True: done; false: the budget is spent.
  bool advance(WorkBudget& budget);

  void archive(Archive& io) { io(direction_); }

 private:
  // A part of a line at which the sweep begins or ends, and where it would go on from there.
  struct Part {
    Vec3 from, to, direction;
  };
  void list(const BladeLine& line, const Vec3& direction);
  double wall_ahead(const Vec3& p, const Vec3& direction) const;

  CutContext& cut_;
  const TetMesh& mesh_;
  Vec3 direction_{};  // in which the sweep went last; 0: in none
  std::vector<Part> parts_;
  std::size_t next_ = 0;
};

}  // namespace incise::core
