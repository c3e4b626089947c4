#include "server/core/cut/conforming/bridge_suspects.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "server/core/cut/conforming/films.hpp"
#include "server/core/mesh/boundary_grid.hpp"

namespace incise::core {

using namespace tolerance;

void BridgeSuspects::keep(HalfFace h) {
  const auto newest = std::min<std::ptrdiff_t>(std::ssize(faces_), 64);
  if (std::find(faces_.end() - newest, faces_.end(), h) != faces_.end()) return;
  if (faces_.size() == kMostBridges) faces_.erase(faces_.begin(), faces_.begin() + kMostBridges / 4);
  faces_.push_back(h);
}

HalfFace BridgeSuspects::next() {
  const HalfFace h = faces_[next_++];
  if (!mesh_.alive(tet_of(h)) || mesh_.opposite(h) == kNone) return kNone;
  const Vec3 middle = mesh_.face_middle(h);
  const auto is_near = [&](const Place& place) {
    return distance(place.middle, middle) < kBridgesApart_h[place.look] * cut_.h;
  };
  if (std::ranges::any_of(places_, is_near) || !may_hold_together(h)) return kNone;
  places_.push_back({middle, 0});
  return h;
}

// Whether something was swept close by a closed face and between its sides: a large one, for small elements follow what is swept.
bool BridgeSuspects::may_hold_together(HalfFace h) const {
  const auto v = mesh_.face_vertices(h);
  const auto is_long = [&](VertexId a, VertexId b) {
    return distance(mesh_.position(a), mesh_.position(b)) >= kBridgeEdge_h * cut_.h;
  };
  if (!is_long(v[0], v[1]) && !is_long(v[1], v[2]) && !is_long(v[2], v[0])) return false;
  const Vec3 middle = mesh_.face_middle(h);
  const Vec3 from = reference_point(cut_, tet_of(h)), to = reference_point(cut_, tet_of(mesh_.opposite(h)));
  const double near_m = kBridgeBeside_h * cut_.h;
  std::size_t looked_at = 0;
  const auto passes_between = [&](const SweptMemory::Quad& quad) {
    return std::ranges::any_of(quad.triangles(), [&](const std::array<Vec3, 3>& triangle) {
      const auto& [a, b, c] = triangle;
      const Vec3 across = cross(b - a, c - a);
      if ((dot(across, from - a) >= 0) == (dot(across, to - a) >= 0) ||
          squared_length(closest_point(middle, a, b, c) - middle) > near_m * near_m)
        return false;
      const Vec3 normal = normalized(across), along = normalized(b - a);
      const auto is_clear = [&](double by_m) {
        return cut_.workspace.swept.stroke_at(middle + by_m * normal, kBridgeClear_h * cut_.h, looked_at) ==
               0;
      };
      // Beside other sweeps there is little to hold together.
      return is_clear(kBridgeDepth_h * cut_.h) && is_clear(-kBridgeDepth_h * cut_.h) &&
             !leads_round(h, middle, along, cross(normal, along), looked_at);
    });
  };
  const bool may =
      cut_.workspace.swept.any_in(Box::around({middle}).widened(near_m), looked_at, passes_between);
  cut_.work.add(looked_at, cost::kQuadsAUnit);
  return may;
}

// Whether tissue leads from the face in the sweep's plane to where nothing was swept, near by: round a rim, as a rule.
bool BridgeSuspects::leads_round(HalfFace h, const Vec3& middle, const Vec3& along, const Vec3& across,
                                 std::size_t& looked_at) const {
  const SweptMemory& swept = cut_.workspace.swept;
  for (int k = 0; k < kBridgeRounds; ++k) {
    const double turn = 2 * std::numbers::pi * k / kBridgeRounds;
    const Vec3 end = middle + kBridgeRound_h * cut_.h * (std::cos(turn) * along + std::sin(turn) * across);
    if (swept.stroke_at(end, kBridgeRoundOff_h * cut_.h, looked_at) != 0 ||
        swept.crosses(middle, end, looked_at))
      continue;
    const auto pass = [this](TetId, double, double) { cut_.work += cost::kLook; };
    if (walk(mesh_, tet_of(h), middle, end, pass, kMostWalked) != kNone) return true;
  }
  return false;
}

void BridgeSuspects::archive(Archive& io) {
  io.list(faces_, 4, [&](HalfFace& h) {
    io(h);
    io.demand(tet_of(h) < mesh_.tet_slots(), "a suspect face of no tetrahedron");
  });
}

}  // namespace incise::core
