#pragma once

#include <algorithm>
#include <array>
#include <span>

#include "server/core/geometry/vec3.hpp"
#include "server/core/stroke/blade.hpp"
#include "server/core/stroke/rigid_motion.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// A rigid motion, and then a strain: how a small part of a body goes that changes its shape. What is straight or flat stays so.
class AffineMotion {
 public:
  // More in one step is not what tissue does.
  static constexpr double kMostStrain = 0.5;

  AffineMotion() = default;
  // The one that takes some points to others best, by least squares. As many of both; none: no motion. A strain across a line or a plane in which all
  // of them lie is none. O(points).
  // `most_strain`: one that is larger (Frobenius norm) is none.
  static AffineMotion fit(std::span<const Vec3> from, std::span<const Vec3> to,
                          double most_strain = kMostStrain);

  Vec3 operator()(const Vec3& p) const;
  BladeLine operator()(const BladeLine& line) const { return {(*this)(line.heel), (*this)(line.tip)}; }
  // Of a direction, of length 1; of none, none.
  Vec3 turn(const Vec3& direction) const;
  // Of the direction across a plane, of length 1.
  Vec3 turn_normal(const Vec3& normal) const;
  // Whether it does anything.
  bool moves() const {
    return rigid_.moves() || std::ranges::any_of(strain_, [](const Vec3& row) { return row != Vec3(); });
  }
  // This part of it, 0 to 1.
  AffineMotion part(double of) const;

  void archive(Archive& io);

 private:
  Vec3 strain(const Vec3& v) const { return {dot(strain_[0], v), dot(strain_[1], v), dot(strain_[2], v)}; }

  RigidMotion rigid_;
  std::array<Vec3, 3> strain_{};  // rows
};

}  // namespace incise::core
