#include "server/core/cut/conforming/placement.hpp"

#include <algorithm>
#include <cmath>

namespace incise::core {

using namespace tolerance;

// The directions in which a vertex may move: within the boundary, along a crease of it, within the swept surface.
int PlaceFinder::freedom(const VertexStar& star, const Vec3* surface_normal, Vec3 (&basis)[3]) const {
  Vec3 normals[3];
  int fixed = 0;
  const auto fix = [&](Vec3 n, double least) {
    for (int i = 0; i < fixed; ++i) n = n - dot(n, normals[i]) * normals[i];
    const double l = length(n);
    if (fixed < 3 && l > least) normals[fixed++] = (1 / l) * n;
  };
  if (surface_normal != nullptr) fix(*surface_normal, 0);
  if (star.on_boundary()) {
    // A vertex moves in the plane of a patch's mean normal by area: there the body wins on one face what it loses on others.
    Vec3 firsts[3], sums[3]{};
    int patches = 0;
    for (const VertexStar::Wall& wall : star.walls()) {
      int k = 0;
      while (k < patches && dot(firsts[k], wall.normal) <= kCosPatch) ++k;
      if (k == 3) continue;
      if (k == patches) firsts[patches++] = wall.normal;
      sums[k] += wall.twice_area * wall.normal;
    }
    for (int k = 0; k < patches; ++k) fix(normalized(sums[k]), k == 0 ? kFirstPatchOff : kNextPatchOff);
  }
  if (fixed == 0) {
    basis[0] = {1, 0, 0};
    basis[1] = {0, 1, 0};
    basis[2] = {0, 0, 1};
    return 3;
  }
  if (fixed == 1) {
    const Vec3& n = normals[0];
    const Vec3 axis = std::abs(n.x) < 0.6 ? Vec3{1, 0, 0} : Vec3{0, 1, 0};
    basis[0] = normalized(cross(n, axis));
    basis[1] = cross(n, basis[0]);
    return 2;
  }
  if (fixed == 2) {
    basis[0] = cross(normals[0], normals[1]);
    return 1;
  }
  return 0;
}

// A pattern search that halves its step.
void PlaceFinder::look_around(const VertexStar& star, bool on_surface, std::uint32_t triangle,
                              const Search& search, Placement& placement) {
  Vec3 basis[3];
  const int count = freedom(star, on_surface ? &cut_.surface()[triangle].normal : nullptr, basis);
  if (count == 0) return;
  double step = kSearchStep_local * star.local_h();
  for (int level = 0; level < search.levels && placement.worst > search.goal; ++level, step *= 0.5) {
    for (int turn = 0; turn < search.turns; ++turn) {
      const Vec3 origin = placement.target;
      bool better = false;
      for (int k = 0; k < 2 * count && placement.worst > search.goal; ++k) {
        const Vec3 p = origin + (k % 2 == 0 ? step : -step) * basis[k / 2];
        better = try_step(star, on_surface, triangle, search.thickness_m, p, placement) || better;
      }
      if (!better) break;
    }
  }
}

// Goes to p, or to the surface there, if that is better.
bool PlaceFinder::try_step(const VertexStar& star, bool on_surface, std::uint32_t& triangle,
                           double thickness_m, Vec3 p, Placement& placement) {
  if (on_surface) {
    Vec3 closest;
    cut_.work += cost::kSurfaceQuery;
    if (!cut_.surface().near(p, kSearchReach_local * star.local_h(), closest, triangle)) return false;
    p = closest;
  }
  if (!star.keeps_boundary(p)) return false;
  const double worst = cut_.worst_at(star, p, placement.worst, thickness_m, flat_);
  if (worst >= placement.worst) return false;
  std::uint32_t crossed;
  double t;
  if (!on_surface && cut_.find_crossing(star.position(), false, p, false, crossed, t)) return false;
  placement = {p, worst};
  return true;
}

Placement PlaceFinder::place(VertexStar& star, VertexId v, const Crossing& crossing, const Vec3& at,
                             double limit, bool search_around) {
  cut_.gather(star, v);
  const Vec3& p = star.position();
  const double thickness_m = kFlat_local * star.local_h();
  const double reach =
      kSnapReach_edge * distance(cut_.mesh.position(crossing.a), cut_.mesh.position(crossing.b));
  std::uint32_t triangle = crossing.triangle;
  Vec3 targets_there[2];
  const int count = targets(star, crossing, at, reach, triangle, targets_there);
  Placement best{p, kInverted};
  for (int i = 0; i < count && best.worst > limit; ++i) {
    const Vec3& target = targets_there[i];
    if (distance(target, p) > reach) continue;
    if (!star.keeps_boundary(target)) continue;
    const double worst = cut_.worst_at(star, target, search_around ? best.worst : std::min(best.worst, limit),
                                       thickness_m, flat_);
    if (worst < best.worst) best = {target, worst};
  }
  if (search_around && best.worst > limit && best.worst < kInverted)
    look_around(star, true, triangle, {limit, thickness_m}, best);
  return best;
}

// Places on the surface for a vertex, the better first: the closest point, then the crossing; a boundary vertex slides along the
// boundary. `triangle` becomes the surface's near the vertex.
int PlaceFinder::targets(const VertexStar& star, const Crossing& crossing, const Vec3& at, double reach,
                         std::uint32_t& triangle, Vec3 (&out)[2]) const {
  const SweptSurface& surface = cut_.surface();
  const Vec3& p = star.position();
  int count = 0;
  Vec3 closest;
  cut_.work += cost::kPlace;
  const bool near = surface.near(p, reach, closest, triangle);
  const Vec3 normal = surface[triangle].normal;
  if (!star.on_boundary()) {
    if (near) out[count++] = closest;
    out[count++] = at;
    return count;
  }
  // Along the line in which the boundary meets the surface (Croll 2007, equations 11 to 14); where two boundary
  // planes meet at v, along their crease.
  Vec3 basis[3];
  const int directions = freedom(star, nullptr, basis);
  Vec3 direction{};
  for (int i = 0; i < directions; ++i) direction += dot(normal, basis[i]) * basis[i];
  const double slope = dot(normal, direction);
  if (slope > kParallelSlope) {
    const Vec3 target = p + (-surface[triangle].signed_distance(p) / slope) * direction;
    if (surface.near(target, kOnSurface_h * cut_.h, closest, triangle)) out[count++] = target;
  }
  // As near to the crossing as the body keeps its volume, within the surface.
  out[count] = at;
  const SweptTriangle& crossed = surface[crossing.triangle];
  const Vec3& area = star.wall_area();
  const Vec3 steepest = area - dot(area, crossed.normal) * crossed.normal;
  const double steepness = squared_length(steepest);
  if (steepness > kParallelSlope * squared_length(area)) {
    const Vec3 target = at + (-dot(area, at - p) / steepness) * steepest;
    if (surface.near(target, kOnSurface_h * cut_.h, closest, triangle)) out[count] = target;
  }
  return count + 1;
}

// At a boundary that runs along the surface, or where an older cut does that ends at the body's own boundary. Where this meets
// the surface at an angle, as at a bump, that would cut off what is to be moved.
bool PlaceFinder::stay(const VertexStar& star, Placement& placement) {
  const SweptSurface& surface = cut_.surface();
  const Vec3& p = star.position();
  const double h = std::min(cut_.h, star.local_h());
  Vec3 closest;
  std::uint32_t triangle = kNone;
  cut_.work += cost::kNearby;
  if (!star.on_boundary() || !surface.near(p, kOne_h * h, closest, triangle)) return false;
  const auto runs_along = [&](const VertexStar::Wall& wall) {
    return std::abs(dot(wall.normal, surface[triangle].normal)) > kCosAlong;
  };
  const auto cut_along = [&](const VertexStar::Wall& wall) { return wall.cut && runs_along(wall); };
  const bool at_skin = distance(p, closest) <= kStay_h * h && std::ranges::all_of(star.walls(), runs_along);
  if (!at_skin && !std::ranges::any_of(star.walls(), cut_along)) return false;
  const double worst = cut_.worst_at(star, p, placement.worst, kFlat_local * star.local_h(), flat_);
  if (worst >= placement.worst) return false;
  placement = {p, worst};
  return true;
}

bool PlaceFinder::stands_for_needle(const VertexStar& star) const {
  if (!star.on_boundary()) return false;
  const bool at_cut = std::ranges::any_of(star.walls(), &VertexStar::Wall::cut);
  const double reach_m = (at_cut ? kCutForNeedle_h : kSkinForNeedle_h) * std::min(cut_.h, star.local_h());
  cut_.work += cost::kNearby;
  return cut_.surface().is_within(star.position(), reach_m);
}

}  // namespace incise::core
