#include "tests/oracle/hands.hpp"

#include <algorithm>

#include "tests/oracle/meetings.hpp"

namespace incise::oracle {

Hand place_hand(std::span<const protocol::PoseSample> samples, const core::MeshData& mesh, std::uint64_t seed,
                std::size_t most) {
  Random random(seed);
  const std::size_t first = samples.size() > most ? random.below(samples.size() - most) : 0;
  samples = samples.subspan(first, std::min(most, samples.size()));
  const auto position = [](const protocol::PoseSample& s) {
    return Vec3{s.position.x, s.position.y, s.position.z};
  };
  Vec3 low = position(samples.front()), high = low;
  for (const auto& sample : samples) core::extend(position(sample), low, high);
  Vec3 from = mesh.positions.at(0), to = from;
  for (const Vec3& p : mesh.positions) core::extend(p, from, to);
  const double size_m = core::distance(from, to);
  const double scale = random.uniform(0.3, 0.8) * size_m / std::max(core::distance(low, high), 1e-6);
  const Vec3 to_middle = 0.5 * (from + to) + random.uniform(0, 0.15) * size_m * random.direction();
  const core::Quat turn = pose_along({}, random.direction()).orientation;
  Hand hand;
  for (const auto& sample : samples) {
    core::Pose pose;
    pose.t_ns = sample.source_ns;
    pose.position = to_middle + scale * core::rotate(turn, position(sample) - 0.5 * (low + high));
    const auto& q = sample.orientation;
    const core::Quat b{q.w, q.x, q.y, q.z}, &a = turn;
    pose.orientation = {
        a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
        a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
    pose.buttons = 1;
    hand.poses.push_back(pose);
  }
  hand.config.always_engaged = true;
  hand.config.speed_limit_m_s = 1e9;
  hand.config.blade = {{0, 0, 0}, random.uniform(0.15, 0.8) * size_m * random.direction()};
  return hand;
}

}  // namespace incise::oracle
