#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "server/core/cut/cut_config.hpp"
#include "server/core/stroke/blade.hpp"
#include "tests/oracle/sample_grid.hpp"

// What blades have swept, from their poses alone.
namespace incise::oracle {

// Where one blade was while it cut without a break.
struct Stroke {
  std::vector<core::BladeLine> lines;
};

// The strokes that poses of one source describe, by the rules of CutConfig: engaged, no jump, no gap.
std::vector<Stroke> strokes_of(std::span<const core::Pose> poses, const core::Blade& blade,
                               const core::CutConfig& config);

struct SweptPart {
  Triangle triangle;
  std::uint32_t stroke = 0;
  double travel = 0;  // of the blade in its stroke, m
};

// The surfaces between the lines as triangles no larger than `size`, and within `tolerance` of the ruled quads. What
// lies outside of the box is left out.
std::vector<SweptPart> swept_surface(std::span<const Stroke> strokes, double size, double tolerance,
                                     const Vec3& low, const Vec3& high);

// Whether anything that a rim may join lies within `reach` of p, on the rim of this stroke after this travel.
using IsNear = std::function<bool(const Vec3& p, double reach, std::uint32_t stroke, double travel)>;

// What closes gaps of up to `reach`: fins along the rims of each stroke (the paths of heel and tip, first and last line), one
// that continues the surface and one to either side of it, in parts no longer than `size`, where is_near() says so. A rim that
// ends this near to another surface, or to the body's boundary, reaches it with one of them. `turns`: also where the blade turns back within
// a stroke.
std::vector<Triangle> rim_fins(std::span<const Stroke> strokes, double size, double reach, const Vec3& low,
                               const Vec3& high, bool turns, const IsNear& is_near);

}  // namespace incise::oracle
