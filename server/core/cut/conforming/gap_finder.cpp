#include "server/core/cut/conforming/gap_finder.hpp"

#include <algorithm>
#include <cmath>

#include "server/core/cut/conforming/films.hpp"

namespace incise::core {

using namespace tolerance;

// Whether all of a face is near the surface, but for what lies at an older cut, and its sides are on either side, or it is part of a rib where
// a sweep begins or ends; or it is what an older cut has left.
bool GapFinder::may_close(Gap& gap) {
  const HalfFace h = gap.face;
  double& off_m = gap.off_m;
  const auto v = mesh_.face_vertices(h);
  // Most have a vertex at the skin that is far from all cuts, which is known from other faces.
  if (std::ranges::any_of(v, [this](VertexId w) { return lies_away(w); })) return false;
  const Vec3 middle = mesh_.face_middle(h);
  if (!is_near(middle, off_m)) {
    gap.meets = gap.by_thickness = holes_.is_hole(h);
    return gap.meets;
  }
  const SweptTriangle& triangle = cut_.surface()[nearest_];
  const double a = triangle.signed_distance(reference_point(cut_, tet_of(h)));
  const double b = triangle.signed_distance(reference_point(cut_, tet_of(mesh_.opposite(h))));
  const bool beside = cut_.is_beside(a, b);
  // What is at an older cut may be farther off, but not in a rib.
  const auto lies_near = [&](VertexId w) { return cut_.on_surface(w) || is_near(w, off_m); };
  const bool near = beside && std::ranges::all_of(v, lies_near) && off_m <= kRib_h * cut_.h;
  const bool is_rib = beside && !is_at_end(middle);
  gap.kind = is_rib ? Gap::Kind::kRib : Gap::Kind::kAcross;
  bool continues = false;
  if (is_rib && (!near || holes_.edges_at_boundary(h, continues) < 2)) return false;
  // Where the sweep runs along an older cut, what is between them is a film.
  if (is_rib && std::ranges::any_of(v, [this](VertexId w) { return cut_.stands(w); })) return false;
  for (VertexId w : v) {
    const bool older = cut_.stands(w) || (!cut_.on_surface(w) && cut_.at_cut(w));
    gap.meets = gap.meets || older;
    if (!older && !lies_near(w)) return false;
  }
  return true;
}

// Whether a face that may_close() refuses, because it is farther off or less is known of it, may be a neck.
bool GapFinder::may_be_neck(Gap& gap) {
  const auto v = mesh_.face_vertices(gap.face);
  if (std::ranges::none_of(v, [this](VertexId w) { return cut_.on_surface(w); })) return false;
  for (VertexId w : v) {
    if (cut_.on_surface(w)) continue;
    const double off_m = off_surface_m(w);
    if (off_m < INFINITY) {
      gap.off_m = std::max(gap.off_m, off_m);
    } else if (!cut_.at_cut(w)) {  // There it lies on what was swept before, by this stroke as well.
      return false;
    }
  }
  bool continues = false;
  // What is several faces wide has some with one edge there.
  return holes_.edges_at_boundary(gap.face, continues) >= (gap.off_m > 0 ? 1 : 2);
}

// How far a vertex of a neck is off the surface; INFINITY: too far.
double GapFinder::off_surface_m(VertexId v) {
  Off& known = far_[v % kOffs];
  if (known.serial == serial_ && known.vertex == v) return known.off_m;
  Vec3 closest;
  cut_.work += cost::kNearby;
  const double reach_m =
      std::clamp(kNeckOff_local * mesh_.local_h(v), kNeckOff_h * cut_.h, kNeckFar_h * cut_.h);
  const bool is_near = cut_.surface().closest(mesh_.position(v), reach_m, closest, nearest_, nearest_);
  known = {serial_, v, is_near ? distance(mesh_.position(v), closest) : INFINITY};
  return known.off_m;
}

// Whether a sweep begins or ends near p.
bool GapFinder::is_at_end(const Vec3& p) {
  const double reach = kJoinReach_h * cut_.h;
  for (std::size_t i = 0; i < cut_.workspace.ends.size(); ++i) {
    const BladeLine& line = cut_.workspace.ends[i].lines[0];
    cut_.work += cost::kLook;
    if (squared_distance_to_segment(p, line.heel, line.tip) <= reach * reach) return true;
  }
  return false;
}

// Whether v is at no cut, and not near what is swept.
bool GapFinder::lies_away(VertexId v) {
  double off_m = 0;
  return !cut_.was_on_surface(v) && !cut_.stands(v) && !cut_.at_cut(v) && !is_near(v, off_m);
}

bool GapFinder::is_near(VertexId v, double& off_m) {
  Off& known = near_[v % kOffs];
  if (known.serial != serial_ || known.vertex != v) {
    double its_m = 0;
    const bool is = is_near(mesh_.position(v), its_m);
    known = {serial_, v, is ? its_m : INFINITY};
  }
  if (known.off_m < INFINITY) off_m = std::max(off_m, known.off_m);
  return known.off_m < INFINITY;
}

bool GapFinder::is_near(const Vec3& p, double& off_m) {
  Vec3 closest;
  cut_.work += cost::kNearby;
  // What was asked last was near, as a rule.
  if (!cut_.surface().closest(p, kOne_h * cut_.h, closest, nearest_, nearest_)) return false;
  // What leads on to a wall may end beyond it, in the air.
  if ((cut_.surface()[nearest_].rim & SweptTriangle::kContinues) != 0 &&
      !cut_.surface().was_swept_within(p, kFarGap_h * cut_.h))
    return false;
  off_m = std::max(off_m, distance(p, closest));
  return true;
}

}  // namespace incise::core
