#include "server/core/stroke/affine_motion.hpp"

#include <cmath>
#include <cstddef>

namespace incise::core {
namespace {

// Where points lie nearly in a line or a plane, what they say of a strain across that is noise: directions in which they reach less far than this part of all
// count for less.
constexpr double kStiffAcross = 1e-3;

// The solution of a symmetric system of three.
Vec3 solve(const std::array<Vec3, 3>& m, const Vec3& b) {
  const Vec3 yz = cross(m[1], m[2]), zx = cross(m[2], m[0]), xy = cross(m[0], m[1]);
  return (1 / dot(m[0], yz)) * (b.x * yz + b.y * zx + b.z * xy);
}

}  // namespace

AffineMotion AffineMotion::fit(std::span<const Vec3> from, std::span<const Vec3> to, double most_strain) {
  AffineMotion made;
  made.rigid_ = RigidMotion::fit(from, to);
  const Vec3 middle = made.rigid_.to_middle();
  std::array<Vec3, 3> spread{}, off{};
  for (std::size_t i = 0; i < from.size(); ++i) {
    const Vec3 r = made.rigid_(from[i]) - middle, d = to[i] - middle - r;
    spread[0] += r.x * r;
    spread[1] += r.y * r;
    spread[2] += r.z * r;
    off[0] += d.x * r;
    off[1] += d.y * r;
    off[2] += d.z * r;
  }
  const double stiff = kStiffAcross * (spread[0].x + spread[1].y + spread[2].z);
  if (!(stiff > 0)) return made;
  spread[0].x += stiff;
  spread[1].y += stiff;
  spread[2].z += stiff;
  double most2 = 0;
  for (std::size_t row = 0; row < 3; ++row) {
    made.strain_[row] = solve(spread, off[row]);
    most2 += squared_length(made.strain_[row]);
  }
  if (!(most2 <= most_strain * most_strain)) made.strain_ = {};
  return made;
}

Vec3 AffineMotion::operator()(const Vec3& p) const {
  const Vec3 there = rigid_(p);
  return there + strain(there - rigid_.to_middle());
}

Vec3 AffineMotion::turn(const Vec3& direction) const {
  const Vec3 turned = rigid_.turn(direction);
  return normalized(turned + strain(turned));
}

Vec3 AffineMotion::turn_normal(const Vec3& normal) const {
  // By the matrix of cofactors: its rows are the cross products of this one's rows.
  const Vec3 a = strain_[0] + Vec3{1, 0, 0}, b = strain_[1] + Vec3{0, 1, 0}, c = strain_[2] + Vec3{0, 0, 1};
  const Vec3 n = rigid_.turn(normal);
  return normalized(Vec3{dot(cross(b, c), n), dot(cross(c, a), n), dot(cross(a, b), n)});
}

AffineMotion AffineMotion::part(double of) const {
  AffineMotion made;
  made.rigid_ = rigid_.part(of);
  for (std::size_t row = 0; row < 3; ++row) made.strain_[row] = of * strain_[row];
  return made;
}

void AffineMotion::archive(Archive& io) {
  rigid_.archive(io);
  for (Vec3& row : strain_) {
    io(row);
    io.demand(squared_length(row) <= kMostStrain * kMostStrain, "a strain larger than a step may have");
  }
}

}  // namespace incise::core
