#pragma once

#include <span>

#include "server/core/geometry/vec3.hpp"
#include "server/core/stroke/blade.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// A turn and a way: how a body goes that keeps its shape.
class RigidMotion {
 public:
  RigidMotion() = default;
  // The one that takes some points to others best, by least squares. As many of both; none: no motion. Where they lie in a line, without a turn around that.
  // O(points).
  static RigidMotion fit(std::span<const Vec3> from, std::span<const Vec3> to);

  Vec3 operator()(const Vec3& p) const { return to_middle_ + rotate(rotation_, p - from_middle_); }
  BladeLine operator()(const BladeLine& line) const { return {(*this)(line.heel), (*this)(line.tip)}; }
  // Of a direction.
  Vec3 turn(const Vec3& direction) const { return rotate(rotation_, direction); }
  // Where it takes the middle of the points that it was fitted to.
  const Vec3& to_middle() const { return to_middle_; }
  // Whether it does anything.
  bool moves() const { return !(from_middle_ == to_middle_ && rotation_ == Quat()); }
  // This part of it, 0 to 1.
  RigidMotion part(double of) const;

  void archive(Archive& io);

 private:
  class Fit;
  Vec3 from_middle_{}, to_middle_{};
  Quat rotation_;
};

}  // namespace incise::core
