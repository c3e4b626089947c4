#pragma once

#include <cstddef>

#include "server/core/geometry/vec3.hpp"

namespace incise::core {

// The volume of a tetrahedron, positive for positive orientation, m^3.
inline double signed_volume(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  return dot(cross(b - a, c - a), d - a) / 6.0;
}

// The cosine of the smallest of the six dihedral angles of a positively oriented tetrahedron (the largest cosine),
// as cos |cos|: monotone in the angle and free of square roots. Some 40 ns. A tetrahedron with a face of zero area,
// or that is not positively oriented, gives kInverted.
double worst_dihedral(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d);

// Larger than any cos |cos|.
inline constexpr double kInverted = 2.0;

// The worst measure of many tetrahedra: they are looked at four at a time.
class WorstDihedral {
 public:
  void begin() {
    worst_ = -kInverted;
    waiting_ = 0;
  }
  void add(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
    put(0, a);
    put(1, b);
    put(2, c);
    put(3, d);
    if (++waiting_ == 4) look();
  }
  // Of all since begin(); -kInverted: there was none.
  double worst();

 private:
  void put(std::size_t corner, const Vec3& p) {
    double(&rows)[3][4] = corners_[corner];
    rows[0][waiting_] = p.x;
    rows[1][waiting_] = p.y;
    rows[2][waiting_] = p.z;
  }
  void look();

  double worst_ = 0;
  std::size_t waiting_ = 0;
  alignas(32) double corners_[4][3][4] = {};  // of those that wait: the coordinates of each corner
};

// The measure that worst_dihedral() has at an angle whose cosine is given.
inline constexpr double dihedral_measure(double cosine) {
  return cosine * (cosine < 0 ? -cosine : cosine);
}

// The angle, degrees, of a measure; 0 for kInverted. For reports: it uses the platform's acos, so no decision may
// depend on it.
double measure_to_degrees(double measure);

}  // namespace incise::core
