#include "tests/oracle/random_cut.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "server/base/check.hpp"

namespace incise::oracle {

using core::Vec3;

const char* to_string(Shape shape) {
  switch (shape) {
    case Shape::kPlanar:
      return "planar";
    case Shape::kTwisted:
      return "twisted";
    case Shape::kCurved:
      return "curved";
    case Shape::kBoth:
      return "both";
  }
  return "?";
}

RandomCut::RandomCut(const core::MeshData& mesh, Shape shape, int segments, std::uint64_t seed)
    : segments_(segments) {
  INCISE_CHECK(!mesh.positions.empty() && segments > 0);
  Vec3 low = mesh.positions[0], high = low, sum{};
  for (const Vec3& p : mesh.positions) {
    extend(p, low, high);
    sum += p;
  }
  std::mt19937_64 random(seed);
  // Of 53 bits: std::uniform_real_distribution may differ between libraries.
  const auto uniform = [&random](double from, double to) {
    return from + (to - from) * static_cast<double>(random() >> 11) * 0x1p-53;
  };
  const auto direction = [&] {
    for (;;) {
      const Vec3 d{uniform(-1, 1), uniform(-1, 1), uniform(-1, 1)};
      const double l = core::length(d);
      if (l > 0.1 && l < 1) return (1 / l) * d;
    }
  };
  normal_ = direction();
  const Vec3 other = direction();
  ahead_ = core::normalized(other - core::dot(other, normal_) * normal_);
  along_ = core::cross(normal_, ahead_);
  const double size = core::distance(low, high);
  middle_ = (1.0 / static_cast<double>(mesh.positions.size())) * sum + (uniform(-0.1, 0.1) * size) * normal_;
  reach_ = 0.8 * size;
  const double turn = uniform(0.1, 0.45), bend = uniform(0.03, 0.125) * size, phase = uniform(0, 2);
  if (shape == Shape::kTwisted || shape == Shape::kBoth) turn_ = turn;
  if (shape == Shape::kCurved || shape == Shape::kBoth) bend_ = bend;
  phase_ = phase;
}

core::BladeLine RandomCut::line(double s) const {
  const double angle = turn_ * (2 * s - 1);
  const Vec3 centre = middle_ + ((2 * s - 1) * reach_) * ahead_ +
                      (bend_ * std::sin(std::numbers::pi * (3 * s + phase_))) * normal_;
  const Vec3 direction = std::cos(angle) * along_ + std::sin(angle) * normal_;
  return {centre - reach_ * direction, centre + reach_ * direction};
}

void RandomCut::push(core::CutSession& session) const {
  // The tool's frame: z along the blade, x ahead.
  session.set_blade(0, {{0, 0, -reach_}, {0, 0, reach_}});
  std::int64_t t_ns = 0;
  for (const core::BladeLine& at : lines()) {
    const Vec3 z = core::normalized(at.tip - at.heel), x = ahead_, y = core::cross(z, x);
    // The rotation with these columns, as a quaternion (Shepperd 1978): the branch with the largest component.
    core::Quat q;
    const double trace = x.x + y.y + z.z;
    if (trace > 0) {
      q = {1 + trace, y.z - z.y, z.x - x.z, x.y - y.x};
    } else if (x.x >= y.y && x.x >= z.z) {
      q = {y.z - z.y, 1 + x.x - y.y - z.z, x.y + y.x, z.x + x.z};
    } else if (y.y >= z.z) {
      q = {z.x - x.z, x.y + y.x, 1 - x.x + y.y - z.z, y.z + z.y};
    } else {
      q = {x.y - y.x, z.x + x.z, y.z + z.y, 1 - x.x - y.y + z.z};
    }
    const double l = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    core::Pose pose;
    pose.t_ns = t_ns += 1'000'000;
    pose.position = 0.5 * (at.heel + at.tip);
    pose.orientation = {q.w / l, q.x / l, q.y / l, q.z / l};
    INCISE_CHECK(core::accepted(session.push(0, pose)), t_ns);
  }
  session.end_stroke(0);
}

double RandomCut::side(const Vec3& p) const {
  // Every blade line lies in a plane across the motion, so only one can be level with p.
  const double s = std::clamp(0.5 * (core::dot(p - middle_, ahead_) / reach_ + 1), 0.0, 1.0);
  const double step = std::min(std::floor(s * segments_), static_cast<double>(segments_ - 1));
  const core::BladeLine from = line(step / segments_), to = line((step + 1) / segments_);
  const double t = s * segments_ - step;
  const Vec3 heel = core::lerp(from.heel, to.heel, t), tip = core::lerp(from.tip, to.tip, t);
  return core::dot(p - heel, core::normalized(core::cross(ahead_, tip - heel)));
}

std::vector<core::BladeLine> RandomCut::lines() const {
  std::vector<core::BladeLine> lines;
  for (int i = 0; i <= segments_; ++i) lines.push_back(line(static_cast<double>(i) / segments_));
  return lines;
}

}  // namespace incise::oracle
