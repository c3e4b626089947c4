#pragma once

#include <algorithm>
#include <cmath>

namespace incise::core {

// A point or a vector in three dimensions. Metres unless a name says otherwise.
struct Vec3 {
  double x = 0, y = 0, z = 0;

  friend bool operator==(const Vec3&, const Vec3&) = default;
};

inline Vec3 operator+(const Vec3& a, const Vec3& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
inline Vec3 operator-(const Vec3& a, const Vec3& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
inline Vec3 operator-(const Vec3& a) {
  return {-a.x, -a.y, -a.z};
}
inline Vec3 operator*(double s, const Vec3& a) {
  return {s * a.x, s * a.y, s * a.z};
}
inline Vec3& operator+=(Vec3& a, const Vec3& b) {
  return a = a + b;
}

inline double dot(const Vec3& a, const Vec3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
inline Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline double squared_length(const Vec3& a) {
  return dot(a, a);
}
inline double length(const Vec3& a) {
  return std::sqrt(dot(a, a));
}  // sqrt is exactly rounded by IEEE 754
inline double distance(const Vec3& a, const Vec3& b) {
  return length(a - b);
}
// The point a + t (b - a).
inline Vec3 lerp(const Vec3& a, const Vec3& b, double t) {
  return a + t * (b - a);
}
// a / |a|, or the zero vector where |a| is zero.
inline Vec3 normalized(const Vec3& a) {
  const double l = length(a);
  return l > 0 ? (1.0 / l) * a : Vec3{};
}
// 0: x, 1: y, 2: z.
inline double coordinate(const Vec3& p, int axis) {
  return axis == 0 ? p.x : axis == 1 ? p.y : p.z;
}
// Extends the box from `low` to `high` by p.
inline void extend(const Vec3& p, Vec3& low, Vec3& high) noexcept {
  low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
  high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
}
inline bool is_finite(const Vec3& a) {
  return std::isfinite(a.x) && std::isfinite(a.y) && std::isfinite(a.z);
}

}  // namespace incise::core
