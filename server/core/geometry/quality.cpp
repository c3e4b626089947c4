#include "server/core/geometry/quality.hpp"

#include <algorithm>
#include <cstring>
#include <numbers>

#include "server/core/geometry/dihedral_lanes.hpp"

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

namespace {

// By the coordinates of each corner.
using FourTets = double[4][3][4];

[[gnu::always_inline]] inline double worst_of_four(const FourTets& tets) {
  DihedralLanes::V3 p[4];
  for (std::size_t k = 0; k < 4; ++k) {
    std::memcpy(&p[k].x, tets[k][0], sizeof p[k].x);
    std::memcpy(&p[k].y, tets[k][1], sizeof p[k].y);
    std::memcpy(&p[k].z, tets[k][2], sizeof p[k].z);
  }
  return DihedralLanes::largest(DihedralLanes::worst(
      DihedralLanes::minus(p[1], p[0]), DihedralLanes::minus(p[2], p[0]), DihedralLanes::minus(p[3], p[0])));
}

double worst_of_four_baseline(const FourTets& tets) {
  return worst_of_four(tets);
}
#if defined(__x86_64__)
// Without fused multiply-add, which would change the bits.
[[gnu::target("avx2")]] double worst_of_four_avx2(const FourTets& tets) {
  return worst_of_four(tets);
}
#endif

decltype(&worst_of_four_baseline) choose_worst_of_four() {
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2")) return &worst_of_four_avx2;
#endif
  return &worst_of_four_baseline;
}
const auto kWorstOfFour = choose_worst_of_four();

}  // namespace

void WorstDihedral::look() {
  worst_ = std::max(worst_, kWorstOfFour(corners_));
  waiting_ = 0;
}

double WorstDihedral::worst() {
  if (waiting_ == 0) return worst_;
  // The other lanes become copies of the last one.
  for (auto& rows : corners_) {
    for (double(&row)[4] : rows) std::fill(row + waiting_, row + 4, row[waiting_ - 1]);
  }
  look();
  return worst_;
}

double measure_to_degrees(double measure) {
  if (measure >= 1.0) return 0.0;
  const double cosine = measure < 0 ? -std::sqrt(-measure) : std::sqrt(measure);
  return std::acos(std::clamp(cosine, -1.0, 1.0)) * 180.0 / std::numbers::pi;
}

}  // namespace incise::core
