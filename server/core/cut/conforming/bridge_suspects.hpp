#pragma once

#include <cstddef>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"

namespace incise::core {

// Faces of a stroke that its surface passes by, and that had to stay closed when it had: some may hold parts together with others. When the stroke ends it
// says around which BridgeFinder is to look.
class BridgeSuspects {
 public:
  explicit BridgeSuspects(CutContext& cut) : cut_(cut), mesh_(cut.mesh) {}

  // Keeps a face. It may be considered often.
  void keep(HalfFace h);
  void clear() { faces_.clear(); }

  void begin() {
    next_ = 0;
    places_.clear();
  }
  bool is_done() const { return next_ == faces_.size() || places_.size() == tolerance::kMaxBridges; }
  // The next face, if it may be part of a bridge and lies away from those that were; else kNone.
  HalfFace next();
  // Of the last one: how far was looked around it, BridgeFinder::look().
  void was_looked_around(std::size_t look) { places_.back().look = look; }

  void archive(Archive& io);

 private:
  struct Place {
    Vec3 middle;
    std::size_t look;
  };

  bool may_hold_together(HalfFace h) const;
  bool leads_round(HalfFace h, const Vec3& middle, const Vec3& along, const Vec3& across,
                   std::size_t& looked_at) const;

  CutContext& cut_;
  const TetMesh& mesh_;
  std::vector<HalfFace> faces_;
  std::size_t next_ = 0;
  std::vector<Place> places_;  // where bridges were looked for
};

}  // namespace incise::core
