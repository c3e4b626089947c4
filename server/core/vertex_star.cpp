#include "server/core/vertex_star.hpp"

#include <algorithm>
#include <cmath>

namespace incise::core {

double VertexStar::worst_at(const Vec3& p, double limit, double thickness, std::vector<TetId>& flat) const {
  flat.clear();
  double worst = -1;
  for (const Corner& c : corners_) {
    if (c.may_flatten) {
      const Vec3 n = cross(c.points[1] - c.points[0], c.points[2] - c.points[0]);
      const double area2 = length(n);
      if (std::abs(dot(n, p - c.points[0])) <= thickness * area2) {
        flat.push_back(c.tet);
        continue;
      }
    }
    worst = std::max(worst, worst_dihedral(p, c.points[0], c.points[1], c.points[2]));
    if (worst > limit) return worst;
  }
  return worst;
}

double VertexStar::worst_now() const {
  double worst = -1;
  for (const Corner& c : corners_) {
    worst = std::max(worst, worst_dihedral(position_, c.points[0], c.points[1], c.points[2]));
  }
  return worst;
}

bool VertexStar::keeps_boundary(const Vec3& p) const {
  constexpr double kDistance_h = 0.03;
  constexpr double kVolume_h3 = 0.003;
  const Vec3 d = p - position_;
  // A pyramid over each boundary face; what lies between interior faces adds up to nothing.
  if (std::abs(dot(wall_area_, d)) > 3 * kVolume_h3 * local_h_ * local_h_ * local_h_) return false;
  for (const Vec3& n : walls_) {
    if (std::abs(dot(n, d)) > kDistance_h * local_h_) return false;
  }
  return true;
}

}  // namespace incise::core
