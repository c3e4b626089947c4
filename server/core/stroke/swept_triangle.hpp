#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "server/core/geometry/vec3.hpp"
#include "server/core/stroke/affine_motion.hpp"

namespace incise::core {

// One triangle of a swept surface.
struct SweptTriangle {
  std::array<Vec3, 3> corners;
  Vec3 normal;        // unit
  double offset = 0;  // normal . x = offset in its plane
  Vec3 low, high;     // bounding box
  // Unit vectors in the plane, pointing inwards from the edge between corners k and k+1, and their offsets:
  // inward[k] . x >= inward_offset[k] on the triangle's side.
  std::array<Vec3, 3> inward;
  std::array<double, 3> inward_offset{};
  std::uint32_t batch = 0;  // that swept it
  // Bit k: the sweep ends at the edge between corners k and k+1. kContinues: no blade has been here, it leads from the sweep's end to a wall.
  // kStarts: the edge between corners 0 and 1 is a part of the line that its quad starts from; kTurns: and the sweep turns sharply there.
  std::uint8_t rim = 0;
  static constexpr std::uint8_t kRims = 7;
  static constexpr std::uint8_t kContinues = 8, kStarts = 16, kTurns = 32;

  double signed_distance(const Vec3& p) const { return dot(normal, p) - offset; }
  // Whether p is straight above or below it, to within `clear_m`, and nearer to its plane than `reach`.
  bool is_under(const Vec3& p, double reach, double clear_m) const {
    bool under = std::abs(signed_distance(p)) < reach;
    for (std::size_t k = 0; k < 3; ++k) under = under && dot(inward[k], p) >= inward_offset[k] - clear_m;
    return under;
  }
};

// Makes the triangle; false where its corners lie on a line (a blade that turns about its heel, or moves along
// itself): it has swept no area.
bool make_swept_triangle(const Vec3& a, const Vec3& b, const Vec3& c, SweptTriangle& out);
// Where a motion takes it.
SweptTriangle moved(const SweptTriangle& triangle, const AffineMotion& motion);

// Whether the segment p q crosses the triangle, decided exactly. A point in the plane counts as on the positive side
// and a segment through an edge as on one fixed side of it, whichever of the triangles at that edge asks: so a
// segment that crosses a surface made of triangles crosses an odd number of them, never none because it slips
// through between two.
bool crosses(const Vec3& p, const Vec3& q, const SweptTriangle& triangle);

// The same where the signed distances of the ends to its plane are known: exact arithmetic decides only within `clear`, m, of
// the plane or of an edge. `at`: where on the segment, at p + at (q - p).
inline bool crosses(const Vec3& p, const Vec3& q, double p_distance, double q_distance,
                    const SweptTriangle& triangle, double clear, double& at) {
  if ((p_distance > clear && q_distance > clear) || (p_distance < -clear && q_distance < -clear))
    return false;
  const double way = p_distance - q_distance;
  at = way == 0 ? 0.5 : std::clamp(p_distance / way, 0.0, 1.0);
  if (std::abs(way) <= clear) return crosses(p, q, triangle);
  const Vec3 x = lerp(p, q, at);
  double inside = INFINITY;
  for (int k = 0; k < 3; ++k)
    inside = std::min(inside, dot(triangle.inward[k], x) - triangle.inward_offset[k]);
  if (inside < -clear) return false;
  if (inside > clear && std::abs(p_distance) > clear && std::abs(q_distance) > clear) return true;
  return crosses(p, q, triangle);
}

// The point of the triangle closest to p (Ericson 2004, "Real-Time Collision Detection", section 5.1.5).
Vec3 closest_point(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) noexcept;
Vec3 closest_point(const Vec3& p, const SweptTriangle& triangle);

// The distance between p and the segment a b, squared.
double squared_distance_to_segment(const Vec3& p, const Vec3& a, const Vec3& b);

}  // namespace incise::core
