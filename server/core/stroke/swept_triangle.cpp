#include "server/core/stroke/swept_triangle.hpp"

#include <algorithm>

#include "server/core/geometry/predicates.hpp"

namespace incise::core {
namespace {

bool before(const Vec3& a, const Vec3& b) {
  if (a.x != b.x) return a.x < b.x;
  if (a.y != b.y) return a.y < b.y;
  return a.z < b.z;
}

// On which side of the segment p q the directed line a b passes: never 0, and for b a always the opposite.
int side(const Vec3& p, const Vec3& q, const Vec3& a, const Vec3& b) {
  if (before(b, a)) return -side(p, q, b, a);
  return orient3d(p, q, a, b) >= 0 ? 1 : -1;
}

// All that follows from the corners and the normal.
void set_bounds(SweptTriangle& triangle) {
  const auto& [a, b, c] = triangle.corners;
  triangle.offset = dot(triangle.normal, a);
  for (std::size_t k = 0; k < 3; ++k) {
    triangle.inward[k] =
        normalized(cross(triangle.normal, triangle.corners[(k + 1) % 3] - triangle.corners[k]));
    triangle.inward_offset[k] = dot(triangle.inward[k], triangle.corners[k]);
  }
  triangle.low = {std::min({a.x, b.x, c.x}), std::min({a.y, b.y, c.y}), std::min({a.z, b.z, c.z})};
  triangle.high = {std::max({a.x, b.x, c.x}), std::max({a.y, b.y, c.y}), std::max({a.z, b.z, c.z})};
}

}  // namespace

bool make_swept_triangle(const Vec3& a, const Vec3& b, const Vec3& c, SweptTriangle& out) {
  const Vec3 n = cross(b - a, c - a);
  const double area2 = squared_length(n);
  const double edges = std::max({squared_length(b - a), squared_length(c - a), squared_length(c - b)});
  // An aspect of one to a million is a line, in double precision.
  if (!(area2 > 1e-12 * edges * edges)) return false;
  out.corners = {a, b, c};
  out.normal = (1.0 / std::sqrt(area2)) * n;
  set_bounds(out);
  return true;
}

// Its corners go as those of its neighbours do, to the last bit.
SweptTriangle moved(const SweptTriangle& triangle, const AffineMotion& motion) {
  SweptTriangle made = triangle;
  for (Vec3& corner : made.corners) corner = motion(corner);
  made.normal = motion.turn_normal(triangle.normal);
  set_bounds(made);
  return made;
}

bool crosses(const Vec3& p, const Vec3& q, const SweptTriangle& triangle) {
  const auto& [a, b, c] = triangle.corners;
  const bool p_above = orient3d(a, b, c, p) >= 0;
  const bool q_above = orient3d(a, b, c, q) >= 0;
  if (p_above == q_above) return false;
  // The same order of p and q for every triangle that is asked.
  const bool swap = before(q, p);
  const Vec3 &s = swap ? q : p, &e = swap ? p : q;
  const int first = side(s, e, a, b);
  return side(s, e, b, c) == first && side(s, e, c, a) == first;
}

double squared_distance_to_segment(const Vec3& p, const Vec3& a, const Vec3& b) {
  const Vec3 u = b - a, w = p - a;
  const double l2 = squared_length(u);
  const double t = l2 > 0 ? std::clamp(dot(w, u) / l2, 0.0, 1.0) : 0.0;
  return squared_length(w - t * u);
}

Vec3 closest_point(const Vec3& p, const SweptTriangle& triangle) {
  return closest_point(p, triangle.corners[0], triangle.corners[1], triangle.corners[2]);
}

Vec3 closest_point(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) noexcept {
  const Vec3 ab = b - a, ac = c - a, ap = p - a;
  const double d1 = dot(ab, ap), d2 = dot(ac, ap);
  if (d1 <= 0 && d2 <= 0) return a;
  const Vec3 bp = p - b;
  const double d3 = dot(ab, bp), d4 = dot(ac, bp);
  if (d3 >= 0 && d4 <= d3) return b;
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return a + (d1 / (d1 - d3)) * ab;
  const Vec3 cp = p - c;
  const double d5 = dot(ab, cp), d6 = dot(ac, cp);
  if (d6 >= 0 && d5 <= d6) return c;
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return a + (d2 / (d2 - d6)) * ac;
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && (d4 - d3) >= 0 && (d5 - d6) >= 0) return b + ((d4 - d3) / ((d4 - d3) + (d5 - d6))) * (c - b);
  const double sum = va + vb + vc;
  if (!(sum > 0)) return a;  // of no area
  return a + (vb / sum) * ab + (vc / sum) * ac;
}

}  // namespace incise::core
