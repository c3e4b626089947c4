#pragma once

#include <vector>

#include "server/core/cut/conforming/crossings.hpp"
#include "server/core/cut/conforming/cut_context.hpp"

namespace incise::core {

struct Placement {
  Vec3 target;
  double worst = kInverted;  // the star's worst measure there
};

// How a better place is looked for: until the measure there is at most `goal`, by `levels` steps, each half of the one before,
// that are each taken in every direction `turns` times at most. `thickness_m`: what counts as flat; below 0: nothing.
struct Search {
  double goal, thickness_m;
  int levels = tolerance::kSearchLevels, turns = tolerance::kSearchTurns;
};

// Where a vertex may go, and where its star is best. Changes nothing.
class PlaceFinder {
 public:
  explicit PlaceFinder(CutContext& cut) : cut_(cut) {}

  // Where on the surface the end v of a crossed edge would best go, until the star's worst measure is at most `limit`. Reads the
  // star. `search`: also looks around for a better place.
  Placement place(VertexStar& star, VertexId v, const Crossing& crossing, const Vec3& at, double limit,
                  bool search);
  // What becomes flat at the place that it has just found, where the worst measure is at most `limit`.
  const std::vector<TetId>& flat() const { return flat_; }
  // Whether a boundary vertex may stand for the surface where it is, and better than at `placement`, which is then replaced.
  bool stay(const VertexStar& star, Placement& placement);
  // Whether a boundary vertex is so near the surface that it may stand for it, however its boundary runs, where all else leaves a needle.
  bool stands_for_needle(const VertexStar& star) const;
  // Looks around for a better place than `placement`, within the boundary, and within the surface where the vertex is
  // `on_surface`, near `triangle`. What is off the surface stays on its side.
  void look_around(const VertexStar& star, bool on_surface, std::uint32_t triangle, const Search& search,
                   Placement& placement);

 private:
  int freedom(const VertexStar& star, const Vec3* surface_normal, Vec3 (&basis)[3]) const;
  int targets(const VertexStar& star, const Crossing& crossing, const Vec3& at, double reach,
              std::uint32_t& triangle, Vec3 (&out)[2]) const;
  bool try_step(const VertexStar& star, bool on_surface, std::uint32_t& triangle, double thickness_m, Vec3 p,
                Placement& placement);

  CutContext& cut_;
  std::vector<TetId> flat_;  // at the place that was looked at last
};

}  // namespace incise::core
