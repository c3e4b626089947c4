#include "server/core/stroke/rigid_motion.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace incise::core {
namespace {

constexpr int kTurns = 3;
// Points in a line say nothing about a turn around that: then there is none.
constexpr double kStiff = 1e-6;
// Of how far they lie from their middle: farther from a line than this.
constexpr double kInLine = 1e-3;

Vec3 middle(std::span<const Vec3> points) {
  Vec3 sum{};
  for (const Vec3& p : points) sum += (1 / static_cast<double>(points.size())) * p;
  return sum;
}

// The smallest turn from one direction to another; where they are opposite, around `axis`, or any.
Quat turn_between(const Vec3& from, const Vec3& to, const Vec3& axis = {}) {
  const Vec3 half = from + to;
  if (squared_length(half) > kInLine * kInLine) {
    const Vec3 amid = normalized(half), u = cross(from, amid);
    return {dot(from, amid), u.x, u.y, u.z};
  }
  const Vec3 across =
      squared_length(axis) > 0 ? axis : cross(from, std::abs(from.x) < 0.5 ? Vec3{1, 0, 0} : Vec3{0, 1, 0});
  const Vec3 u = normalized(across);
  return {0, u.x, u.y, u.z};
}

}  // namespace

class RigidMotion::Fit {
 public:
  Fit(std::span<const Vec3> from, std::span<const Vec3> to) : from_(from), to_(to) {
    motion_.from_middle_ = middle(from);
    motion_.to_middle_ = middle(to);
    turn_roughly();
    // Each time by the turn that is best while it is small.
    for (int i = 0; i < kTurns; ++i) turn();
  }
  const RigidMotion& motion() const { return motion_; }

 private:
  Vec3 from(std::size_t i) const { return from_[i] - motion_.from_middle_; }
  Vec3 to(std::size_t i) const { return to_[i] - motion_.to_middle_; }

  // The first of those that this takes farthest.
  template <class Place>
  std::size_t farthest(Place place) const {
    std::size_t most = 0;
    double most_m2 = squared_length(place(0));
    for (std::size_t i = 1; i < from_.size(); ++i) {
      const double m2 = squared_length(place(i));
      if (!(m2 > most_m2)) continue;
      most = i;
      most_m2 = m2;
    }
    return most;
  }

  // By any angle: the turn that takes the farthest point's direction along, and then the one around it that takes along the plane of the point that is
  // farthest beside it. A body that is laid on its other side in one step turns by more than steps of small turns find.
  void turn_roughly() {
    const std::size_t far = farthest([this](std::size_t i) { return from(i); });
    const double far_m = length(from(far));
    if (far_m == 0 || squared_length(to(far)) == 0) return;
    const Vec3 axis = normalized(to(far));
    motion_.rotation_ = turn_between(normalized(from(far)), axis);
    const auto beside = [&](const Vec3& p) { return p - dot(p, axis) * axis; };
    const auto turned_beside = [&](std::size_t i) { return beside(motion_.turn(from(i))); };
    const std::size_t side = farthest(turned_beside);
    const Vec3 before = turned_beside(side), after = beside(to(side));
    if (std::min(length(before), length(after)) <= kInLine * far_m) return;
    motion_.rotation_ = product(turn_between(normalized(before), normalized(after), axis), motion_.rotation_);
  }

  void turn() {
    Vec3 columns[3] = {}, sum{};
    for (std::size_t i = 0; i < from_.size(); ++i) {
      const Vec3 r = motion_.turn(from(i));
      const double l2 = squared_length(r);
      columns[0] += Vec3{l2, 0, 0} - r.x * r;
      columns[1] += Vec3{0, l2, 0} - r.y * r;
      columns[2] += Vec3{0, 0, l2} - r.z * r;
      sum += cross(r, to(i));
    }
    const double stiff = kStiff * (columns[0].x + columns[1].y + columns[2].z);
    columns[0].x += stiff;
    columns[1].y += stiff;
    columns[2].z += stiff;
    const double det = dot(columns[0], cross(columns[1], columns[2]));
    if (!(det > 0)) return;
    const Vec3 half =
        (0.5 / det) * Vec3{dot(sum, cross(columns[1], columns[2])), dot(sum, cross(columns[2], columns[0])),
                           dot(sum, cross(columns[0], columns[1]))};
    motion_.rotation_ = product({1, half.x, half.y, half.z}, motion_.rotation_).normalized();
  }

  std::span<const Vec3> from_, to_;
  RigidMotion motion_;
};

RigidMotion RigidMotion::fit(std::span<const Vec3> from, std::span<const Vec3> to) {
  return from.empty() ? RigidMotion() : Fit(from, to).motion();
}

RigidMotion RigidMotion::part(double of) const {
  RigidMotion made = *this;
  made.to_middle_ = lerp(from_middle_, to_middle_, of);
  const Quat& q = rotation_;
  const double sign = q.w < 0 ? -of : of;
  made.rotation_ = Quat{(1 - of) + sign * q.w, sign * q.x, sign * q.y, sign * q.z}.normalized();
  return made;
}

void RigidMotion::archive(Archive& io) {
  io(from_middle_);
  io(to_middle_);
  for (double* q : {&rotation_.w, &rotation_.x, &rotation_.y, &rotation_.z}) {
    io(*q);
    io.demand(std::abs(*q) <= 1.001, "a rotation that is not one");
  }
}

}  // namespace incise::core
