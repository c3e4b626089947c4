#include "server/haptics/rest_map.hpp"

#include <algorithm>
#include <cmath>

#include "server/core/mesh/boundary_grid.hpp"

namespace incise::haptics {
namespace {

using core::BladeLine;
using core::TetId;
using core::Vec3;
using core::VertexId;

constexpr double kSame_h = 1e-6;  // two turns that end so near each other have found the place
// A tetrahedron that a cut has made thinner than this part of what it was says little of the tissue around it.
constexpr double kThinnest = 0.05;
constexpr int kHalvings = 5;  // of a piece with one end outside: its last 32nd holds the boundary

// From the corners' places at rest and now.
LocalMap affine(const std::array<Vec3, 4>& rest, const std::array<Vec3, 4>& now) noexcept {
  LocalMap map;
  map.rest0 = rest[0];
  map.now0 = now[0];
  const Vec3 r[3] = {rest[1] - rest[0], rest[2] - rest[0], rest[3] - rest[0]};
  const Vec3 n[3] = {now[1] - now[0], now[2] - now[0], now[3] - now[0]};
  // With the edges as columns of R and N: F = N R^-1, and its inverse R N^-1.
  const auto quotient = [](const Vec3* of, const Vec3* by, Mat3& result) {
    const double volume = dot(by[0], cross(by[1], by[2]));
    if (!(std::abs(volume) > 0)) return false;
    const Vec3 rows[3] = {(1 / volume) * cross(by[1], by[2]), (1 / volume) * cross(by[2], by[0]),
                          (1 / volume) * cross(by[0], by[1])};
    result.x = rows[0].x * of[0] + rows[1].x * of[1] + rows[2].x * of[2];
    result.y = rows[0].y * of[0] + rows[1].y * of[1] + rows[2].y * of[2];
    result.z = rows[0].z * of[0] + rows[1].z * of[1] + rows[2].z * of[2];
    return is_finite(result.x) && is_finite(result.y) && is_finite(result.z);
  };
  if (!quotient(n, r, map.now_from_rest) || !quotient(r, n, map.rest_from_now))
    map.now_from_rest = map.rest_from_now = {};
  return map;
}

// Walks through `body` from p in `tet` to q. The tetrahedron of q, or where the way leaves the body the last one (`left`).
TetId walk_to(const core::TetMesh& body, TetId tet, const Vec3& p, const Vec3& q, bool& left,
              ProbeWork& work) noexcept {
  const std::uint32_t room = ProbeWork::kMostTets - work.tets;
  std::uint32_t passed = 0;
  TetId last = tet;
  const TetId found = core::walk(
      body, tet, p, q,
      [&](TetId t, double, double) {
        ++passed;
        last = t;
      },
      room);
  work.tets += passed;
  work.cut_short = work.cut_short || passed == room;
  left = found == core::kNone;
  return last;
}

}  // namespace

TetId locate(const core::TetMesh& body, const SurfaceTree& surface, const Vec3& p, ProbeWork& work) noexcept {
  const Vec3 low = surface.low(), high = surface.high();
  if (!(p.x >= low.x && p.y >= low.y && p.z >= low.z && p.x <= high.x && p.y <= high.y && p.z <= high.z))
    return core::kNone;
  const double far = 2 * distance(low, high);
  // A ray that grazes an edge can mislead; hardly all three.
  for (const Vec3& way : {Vec3{0.48, 0.6, 0.64}, Vec3{-0.6, 0.48, -0.64}, Vec3{0.64, -0.6, -0.48}}) {
    const BladeLine ray{p, p + far * way};
    const auto crossing = surface.first_crossing(ray, work);
    if (!crossing) continue;
    if (crossing->entering) return core::kNone;
    const std::uint32_t room = ProbeWork::kMostTets - work.tets;
    std::uint32_t passed = 0;
    const TetId found = core::walk(
        body, core::tet_of(crossing->face), lerp(ray.heel, ray.tip, crossing->at), p,
        [&](TetId, double, double) { ++passed; }, room);
    work.tets += passed;
    if (found != core::kNone) return found;
  }
  return core::kNone;
}

Vec3 RestLine::rest(double at) const noexcept {
  int i = 1;
  while (i < count - 1 && places[static_cast<std::size_t>(i)].at < at) ++i;
  const Place &a = places[static_cast<std::size_t>(i - 1)], &b = places[static_cast<std::size_t>(i)];
  return lerp(a.rest, b.rest, (at - a.at) / (b.at - a.at));
}

TetId RestLine::tet(double at) const noexcept {
  const Place* nearest = places.data();
  for (const Place& place : all()) {
    if (std::abs(place.at - at) < std::abs(nearest->at - at)) nearest = &place;
  }
  return nearest->tet;
}

RestMap::RestMap(const core::TetMesh& loaded, const SurfaceTree& surface)
    : loaded_(loaded), surface_(surface) {
  // Neighbours in the tree's order lie together, so a regular choice of them is spread over the body.
  const std::size_t n = surface.faces();
  for (std::size_t i = 0; i < std::min(n, kAnchors); ++i) {
    const core::HalfFace face = surface.face(i * n / std::min(n, kAnchors));
    anchors_.push_back({core::tet_of(face), loaded.face_vertices(face)[0]});
  }
}

LocalMap RestMap::map(TetId loaded) const noexcept {
  if (!deformed()) return {};
  std::array<Vec3, 4> rest, now;
  // Its own vertices: which side of a cut it is on, its copies know.
  if (now_->alive(loaded)) {
    const auto& v = now_->vertices(loaded);
    for (std::size_t i = 0; i < 4; ++i) {
      rest[i] = now_->rest_position(v[i]);
      now[i] = now_->position(v[i]);
    }
    if (core::signed_volume(rest[0], rest[1], rest[2], rest[3]) > kThinnest * loaded_.volume(loaded))
      return affine(rest, now);
  }
  const auto& v = loaded_.vertices(loaded);
  int alive = 0;
  Vec3 shift;
  for (std::size_t i = 0; i < 4; ++i) {
    rest[i] = now_->rest_position(v[i]);
    now[i] = now_->position(v[i]);
    if (now_->vertex_tet(v[i]) == core::kNone) continue;
    ++alive;
    shift += now[i] - rest[i];
  }
  if (alive == 4 && core::signed_volume(rest[0], rest[1], rest[2], rest[3]) > 0) return affine(rest, now);
  LocalMap moved;
  moved.now0 = alive > 0 ? (1.0 / alive) * shift : Vec3{};
  return moved;
}

TetId RestMap::nearest_anchor(const Vec3& p) const noexcept {
  TetId nearest = core::kNone;
  double nearest2 = INFINITY;
  for (const Anchor& anchor : anchors_) {
    const double distance2 = squared_length(now_->position(anchor.vertex) - p);
    if (distance2 >= nearest2) continue;
    nearest2 = distance2;
    nearest = anchor.tet;
  }
  return nearest;
}

RestLine::Place RestMap::find(const Vec3& p, TetId from, ProbeWork& work) const noexcept {
  RestLine::Place place;
  place.known = true;
  place.tet = from;
  place.rest = map(from).rest(p);
  const double same = kSame_h * loaded_.mean_edge_length();
  for (int turn = 0; turn < kMostTurns; ++turn) {
    bool left = false;
    TetId next = walk_to(loaded_, place.tet, loaded_.barycentre(place.tet), place.rest, left, work);
    if (left) {
      // Outside, or behind a hollow.
      const TetId found = locate(loaded_, surface_, place.rest, work);
      if (found != core::kNone) {
        next = found;
        left = false;
      }
    }
    place.inside = !left;
    if (next == place.tet) return place;
    const Vec3 before = place.rest;
    place.tet = next;
    place.rest = map(next).rest(p);
    if (distance(before, place.rest) < same) return place;
  }
  place.inside = false;
  place.gap = true;
  return place;
}

RestMap::Hold RestMap::hold(const Vec3& p, TetId from, ProbeWork& work) const noexcept {
  Hold best;
  best.most = INFINITY;
  if (!now_ || anchors_.empty()) return best;
  const TetId loaded = find(p, from == core::kNone ? nearest_anchor(p) : from, work).tet;
  // What a cut has left of this tetrahedron may be on the other side; its neighbours lead to this one.
  TetId starts[5] = {loaded};
  for (int f = 0; f < 4; ++f) starts[f + 1] = loaded_.neighbor(loaded, f);
  for (const TetId start : starts) {
    if (start == core::kNone || !now_->alive(start)) continue;
    bool left = false;
    const TetId t = walk_to(*now_, start, now_->barycentre(start), p, left, work);
    const auto& v = now_->vertices(t);
    const Vec3 &a = now_->position(v[0]), &b = now_->position(v[1]), &c = now_->position(v[2]),
               &d = now_->position(v[3]);
    const double volume = core::signed_volume(a, b, c, d);
    if (!(std::abs(volume) > 0)) continue;
    Hold hold{t, loaded, {}, 0};
    hold.weights = {core::signed_volume(p, b, c, d) / volume, core::signed_volume(a, p, c, d) / volume,
                    core::signed_volume(a, b, p, d) / volume, 0};
    hold.weights[3] = 1 - hold.weights[0] - hold.weights[1] - hold.weights[2];
    for (const double weight : hold.weights) hold.most = std::max(hold.most, std::abs(weight));
    if (hold.most < best.most) best = hold;
    if (!left) break;
  }
  return best;
}

RestLine RestMap::line(const BladeLine& line, ProbeWork& work) const noexcept {
  RestLine found;
  found.length_m = distance(line.heel, line.tip);
  found.deformed = deformed() && !anchors_.empty();
  const auto add = [&](RestLine::Place place, double at) {
    place.at = at;
    found.places[static_cast<std::size_t>(found.count++)] = place;
    return place;
  };
  if (!found.deformed) {
    for (const double at : {0.0, 1.0}) {
      RestLine::Place place;
      place.rest = at == 0 ? line.heel : line.tip;
      add(place, at);
    }
    return found;
  }
  // A place that begins far from where it is may not find itself from the one before.
  const auto look = [&](const Vec3& p, TetId from) {
    const RestLine::Place place = find(p, from, work);
    if (!place.gap) return place;
    const RestLine::Place again = find(p, nearest_anchor(p), work);
    return again.gap ? place : again;
  };
  RestLine::Place last = add(look(line.heel, nearest_anchor(line.heel)), 0);
  for (int i = 1; i <= RestLine::kMostPieces; ++i) {
    const double at = static_cast<double>(i) / RestLine::kMostPieces;
    const RestLine::Place next = look(lerp(line.heel, line.tip, at), last.tet);
    if (next.inside != last.inside) {
      // The boundary is in this piece: it must not be blurred.
      RestLine::Place low = last, high = next;
      high.at = at;
      for (int k = 0; k < kHalvings; ++k) {
        const double middle_at = 0.5 * (low.at + high.at);
        RestLine::Place middle = look(lerp(line.heel, line.tip, middle_at), low.inside ? low.tet : high.tet);
        middle.at = middle_at;
        (middle.inside == low.inside ? low : high) = middle;
      }
      if (low.at > last.at) add(low, low.at);
      if (high.at < at) add(high, high.at);
    }
    last = add(next, at);
  }
  return found;
}

}  // namespace incise::haptics
