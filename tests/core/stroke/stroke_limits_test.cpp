// Both sides of the limits of a stroke.

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "server/core/stroke/jump.hpp"
#include "server/core/stroke/stroke_builder.hpp"

namespace incise::core {
namespace {

constexpr std::int64_t kMs = 1'000'000;

struct Strokes {
  Strokes() {
    config.batch_h = 1;
    config.blade = {{0.01, 0.02, 0.03}, {0.02, 0.01, -0.05}};
    config.always_engaged = true;
  }
  StrokeBuilder builder() { return {0, config, 0.01, strokes}; }
  // The lines of all batches that wait.
  std::vector<BladeLine> lines() {
    std::vector<BladeLine> all;
    for (Batch batch; !queue.empty();) {
      queue.pop(batch);
      all.insert(all.end(), batch.lines.begin(), batch.lines.end());
    }
    return all;
  }
  CutConfig config;
  std::uint32_t strokes = 0;
  BatchQueue queue;
};

TEST(StrokeLimits, AGapOfExactlyTheLimitIsNone) {
  Strokes s;
  s.config.gap_limit_s = 0.25;
  for (const std::int64_t gap_ms : {250, 251}) {
    StrokeBuilder builder = s.builder();
    builder.push({1000 * kMs, {}, {}, 0}, s.queue);
    const PoseVerdict verdict = builder.push({(1000 + gap_ms) * kMs, {0.001, 0, 0}, {}, 0}, s.queue);
    EXPECT_EQ(verdict, gap_ms == 250 ? PoseVerdict::kAccepted : PoseVerdict::kNewStroke);
  }
}

TEST(StrokeLimits, AJumpIsTooLateOrTooFar) {
  CutConfig config;
  config.speed_limit_m_s = 2;
  config.gap_limit_s = 0.25;
  const Blade blade{{0, 0, 0}, {0, 0, -0.05}};
  const Quat half_turn{0, 1, 0, 0};
  const auto jumps = [&](const Pose& to) { return is_jump(config, blade, {}, to); };
  EXPECT_FALSE(jumps({100 * kMs, {0.2, 0, 0}, {}, 0}));
  EXPECT_TRUE(jumps({100 * kMs, {std::nextafter(0.2, 1), 0, 0}, {}, 0}));
  EXPECT_FALSE(jumps({50 * kMs, {}, half_turn, 0})) << "its tip moves by 0.1 m";
  EXPECT_TRUE(jumps({49 * kMs, {}, half_turn, 0}));
  // Times nearer than 1 ms count as that: they are of a source that stamps what it sends late.
  EXPECT_FALSE(jumps({1, {0.002, 0, 0}, {}, 0}));
  EXPECT_TRUE(jumps({1, {0.0021, 0, 0}, {}, 0}));
  EXPECT_TRUE(jumps({kMs, {0.0021, 0, 0}, {}, 0}));
  EXPECT_FALSE(jumps({250 * kMs, {}, {}, 0}));
  EXPECT_TRUE(jumps({250 * kMs + 1, {}, {}, 0})) << "also where it did not move";
  EXPECT_TRUE(jumps({kMs, {std::nan(""), 0, 0}, {}, 0}));
  // A source's clock may have any origin.
  Pose first, last;
  first.t_ns = std::numeric_limits<std::int64_t>::min();
  last.t_ns = std::numeric_limits<std::int64_t>::max();
  EXPECT_EQ(elapsed_ns(first, last), std::numeric_limits<std::uint64_t>::max());
  EXPECT_TRUE(is_jump(config, blade, first, last));
}

// A quaternion that is a little off unit length turns the blade and does not stretch it.
TEST(StrokeLimits, AQuaternionIsMadeUnit) {
  const Quat turns[] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}, {0.5, 0.5, 0.5, 0.5}};
  for (const Quat& q : turns) {
    std::vector<BladeLine> all[2];
    for (const int off : {0, 1}) {
      Strokes s;
      StrokeBuilder builder = s.builder();
      const double scale = off ? 1.009 : 1;
      for (int i = 0; i < 2; ++i) {
        const Quat given{scale * q.w, scale * q.x, scale * q.y, scale * q.z};
        ASSERT_EQ(builder.push({i * 10 * kMs, {0.001 * i, 0, 0}, given, 0}, s.queue), PoseVerdict::kAccepted);
      }
      builder.end_stroke(s.queue);
      all[off] = s.lines();
    }
    ASSERT_EQ(all[0].size(), 2u);
    ASSERT_EQ(all[1].size(), 2u);
    for (std::size_t i = 0; i < 2; ++i) EXPECT_LT(travel(all[0][i], all[1][i]), 1e-12);
  }
  Strokes s;
  StrokeBuilder builder = s.builder();
  EXPECT_EQ(builder.push({0, {}, {1.0101, 0, 0, 0}, 0}, s.queue), PoseVerdict::kNotUnit);
  EXPECT_EQ(builder.push({0, {}, {0.9899, 0, 0, 0}, 0}, s.queue), PoseVerdict::kNotUnit);
}

TEST(StrokeLimits, APlaceLiesWithinTenKilometres) {
  Strokes s;
  StrokeBuilder builder = s.builder();
  EXPECT_EQ(builder.push({0, {kFarthest_m, 0, 0}, {}, 0}, s.queue), PoseVerdict::kAccepted);
  EXPECT_EQ(builder.push({kMs, {0, std::nextafter(kFarthest_m, 2e4), 0}, {}, 0}, s.queue),
            PoseVerdict::kNotFinite);
}

// A hand that trembles in place for long: what it did is passed on from time to time, not kept.
TEST(StrokeLimits, ATremblingHandsPosesAreNotKeptForEver) {
  Strokes s;
  StrokeBuilder builder = s.builder();
  for (int i = 0; i < 2000; ++i) builder.push({i * kMs, {1e-5 * (i % 2), 0, 0}, {}, 0}, s.queue);
  EXPECT_GE(s.lines().size(), 4u);
}

// A stroke ends where the blade was, however it trembled on the way.
TEST(StrokeLimits, ATremblingStrokeEndsAtItsLastPose) {
  Strokes s;
  StrokeBuilder builder = s.builder();
  Pose pose;
  for (int i = 0; i < 40; ++i) {
    pose = {i * kMs, {1e-5 * i, i % 2 ? 4e-4 : 0, 0}, {}, 0};
    builder.push(pose, s.queue);
  }
  builder.end_stroke(s.queue);
  const std::vector<BladeLine> lines = s.lines();
  ASSERT_FALSE(lines.empty());
  EXPECT_LT(travel(lines.back(), blade_line(s.config.blade, pose)), 1e-12);
}

}  // namespace
}  // namespace incise::core
