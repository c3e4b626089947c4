#include "server/core/geometry/quality.hpp"

#include <algorithm>
#include <numbers>

namespace incise::core {

double worst_dihedral(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  const Vec3 u = b - a, v = c - a, w = d - a;
  // Outward normals, twice the area long, of the faces opposite to d, c and b; they sum to zero with a's.
  const Vec3 nd = cross(v, u);
  const Vec3 nc = cross(u, w);
  const Vec3 nb = cross(w, v);
  if (dot(nd, w) >= 0) return kInverted;
  const Vec3 na = -(nd + nc + nb);
  const double qa = squared_length(na), qb = squared_length(nb), qc = squared_length(nc),
               qd = squared_length(nd);
  const double product = qa * qb * qc * qd;
  if (!(product > 0)) return kInverted;
  // cos of the angle between faces i and j is -ni.nj / (|ni| |nj|).
  const auto measure = [](const Vec3& m, const Vec3& n, double qm, double qn) {
    const double cosine = -dot(m, n);
    return cosine * std::abs(cosine) / (qm * qn);
  };
  const double first = std::max({measure(na, nb, qa, qb), measure(na, nc, qa, qc), measure(na, nd, qa, qd)});
  const double second = std::max({measure(nb, nc, qb, qc), measure(nb, nd, qb, qd), measure(nc, nd, qc, qd)});
  return std::max(first, second);
}

double measure_to_degrees(double measure) {
  if (measure >= 1.0) return 0.0;
  const double cosine = measure < 0 ? -std::sqrt(-measure) : std::sqrt(measure);
  return std::acos(std::clamp(cosine, -1.0, 1.0)) * 180.0 / std::numbers::pi;
}

}  // namespace incise::core
