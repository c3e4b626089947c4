#include "server/core/stroke/stroke_builder.hpp"

#include <gtest/gtest.h>

#include <deque>
#include <functional>
#include <limits>

#include "server/core/mesh/measure.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using testing::Random;

constexpr double kH = 0.01;  // of the mesh that is imagined
constexpr std::int64_t kMs = 1000000;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

CutConfig config() {
  CutConfig c;
  c.batch_h = 1;
  c.blade = {{0, 0, 0}, {0, 0, -0.05}};
  c.always_engaged = true;
  return c;
}

Pose at(std::int64_t t_ms, double x, double y = 0, double z = 0) {
  return {t_ms * kMs, {x, y, z}, {}, 0};
}

Quat about_x(double angle) {
  return {std::cos(angle / 2), std::sin(angle / 2), 0, 0};
}

// A builder with what it gave so far.
struct Recorder {
  explicit Recorder(const CutConfig& c = config(), double h = kH) : builder(3, c, h, strokes) {}
  PoseVerdict push(const Pose& pose) {
    const PoseVerdict verdict = builder.push(pose, queue);
    drain();
    return verdict;
  }
  void end() {
    builder.end_stroke(queue);
    drain();
  }
  void drain() {
    for (Batch batch; !queue.empty();) {
      queue.pop(batch);
      batches.push_back(batch);
    }
  }

  BatchQueue queue;
  std::uint32_t strokes = 0;
  std::deque<Batch> batches;
  StrokeBuilder builder;
};

// The rules of every stroke: numbered from 1, each batch begins where the last one ended, one ends it.
void expect_well_formed(const std::deque<Batch>& batches) {
  const Batch* last = nullptr;
  for (const Batch& batch : batches) {
    ASSERT_FALSE(batch.lines.empty());
    EXPECT_EQ(batch.source, 3u);
    EXPECT_LE(batch.from_t_ns, batch.to_t_ns);
    if (last != nullptr && last->stroke == batch.stroke) {
      EXPECT_EQ(batch.number, last->number + 1);
      EXPECT_EQ(batch.lines.front(), last->lines.back());
      EXPECT_EQ(batch.from_t_ns, last->to_t_ns);
      EXPECT_FALSE(last->ends_stroke);
    } else {
      EXPECT_EQ(batch.number, 1u);
      if (last != nullptr) {
        EXPECT_TRUE(last->ends_stroke);
        EXPECT_GT(batch.stroke, last->stroke);
      }
    }
    last = &batch;
  }
}

// The distance to a surface that is expected to be near; infinite where it is farther than h.
double distance_to(const SweptSurface& surface, const Vec3& p) {
  Vec3 closest;
  std::uint32_t triangle = 0;
  return surface.closest(p, kH, closest, triangle) ? distance(p, closest) : kInfinity;
}

SweptSurface surface_of(const std::deque<Batch>& batches) {
  SweptSurface surface;
  for (const Batch& batch : batches) add_sweep(surface, batch.lines, 1e-3 * kH);
  surface.build();
  return surface;
}

// ---------------------------------------------------------------------------------------------- verdicts

TEST(StrokeBuilder, EveryVerdict) {
  Recorder run;
  EXPECT_EQ(run.push(at(0, 0)), PoseVerdict::kAccepted);
  EXPECT_EQ(run.push(at(1, 0.001)), PoseVerdict::kAccepted);
  EXPECT_EQ(run.push(at(1, 0.002)), PoseVerdict::kTimeNotIncreasing);
  EXPECT_EQ(run.push(at(-5, 0.002)), PoseVerdict::kTimeNotIncreasing);
  EXPECT_EQ(run.push(at(2, kNan)), PoseVerdict::kNotFinite);
  EXPECT_EQ(run.push(at(2, 0, kInfinity)), PoseVerdict::kNotFinite);
  EXPECT_EQ(run.push(at(2, 0, 0, 2 * kFarthest_m)), PoseVerdict::kNotFinite);
  EXPECT_EQ(run.push({2 * kMs, {}, {kNan, 0, 0, 0}, 0}), PoseVerdict::kNotFinite);
  EXPECT_EQ(run.push({2 * kMs, {}, {1e200, 0, 0, 0}, 0}), PoseVerdict::kNotFinite) << "its length overflows";
  EXPECT_EQ(run.push({2 * kMs, {}, {0, 0, 0, 0}, 0}), PoseVerdict::kNotUnit);
  EXPECT_EQ(run.push({2 * kMs, {}, {1.02, 0, 0, 0}, 0}), PoseVerdict::kNotUnit);
  EXPECT_EQ(run.push({2 * kMs, {0.002, 0, 0}, {1.009, 0, 0, 0}, 0}), PoseVerdict::kAccepted)
      << "rounded by its source";
  EXPECT_EQ(run.push(at(3, 0.5)), PoseVerdict::kNewStroke) << "500 m/s";
  EXPECT_EQ(run.push(at(1000, 0.5)), PoseVerdict::kNewStroke) << "a gap of a second";
  EXPECT_EQ(run.push(at(1001, 0.5)), PoseVerdict::kAccepted) << "the same place again";
}

TEST(StrokeBuilder, RejectedPosesChangeNothing) {
  Recorder run, clean;
  for (int i = 0; i < 300; ++i) {
    const Pose good = at(10 * i, 0.0009 * i);
    EXPECT_EQ(run.push(good), PoseVerdict::kAccepted);
    EXPECT_EQ(clean.push(good), PoseVerdict::kAccepted);
    EXPECT_FALSE(accepted(run.push(at(10 * i + 1, kNan))));
    EXPECT_FALSE(accepted(run.push({(10 * i + 2) * kMs, {9, 9, 9}, {3, 0, 0, 0}, 0})));
    EXPECT_FALSE(accepted(run.push(at(10 * i - 7, 5))));
  }
  run.end();
  clean.end();
  ASSERT_EQ(run.batches.size(), clean.batches.size());
  EXPECT_GT(run.batches.size(), 10u);
  for (std::size_t i = 0; i < run.batches.size(); ++i)
    EXPECT_EQ(run.batches[i].lines, clean.batches[i].lines);
  expect_well_formed(run.batches);
}

// The whole range of a 64-bit clock: the difference of two times does not fit in one.
TEST(StrokeBuilder, ExtremeTimes) {
  Recorder run;
  const auto low = std::numeric_limits<std::int64_t>::min(), high = std::numeric_limits<std::int64_t>::max();
  EXPECT_EQ(run.push({low, {0, 0, 0}, {}, 0}), PoseVerdict::kAccepted);
  EXPECT_EQ(run.push({low + kMs, {0.001, 0, 0}, {}, 0}), PoseVerdict::kAccepted);
  EXPECT_EQ(run.push({high, {0.002, 0, 0}, {}, 0}), PoseVerdict::kNewStroke);
  EXPECT_EQ(run.push({high, {0.003, 0, 0}, {}, 0}), PoseVerdict::kTimeNotIncreasing);
  run.end();
  expect_well_formed(run.batches);
}

// ---------------------------------------------------------------------------------------------- strokes

TEST(StrokeBuilder, TheButtonBeginsAndEndsAStroke) {
  CutConfig c = config();
  c.always_engaged = false;
  c.engage_buttons = 0b110;
  Recorder run(c);
  std::int64_t t = 0;
  const auto move = [&](double from, double to, std::uint32_t buttons) {
    for (int i = 1; i <= 40; ++i) {
      Pose pose = at(++t * 2, from + (to - from) * i / 40);
      pose.buttons = buttons;
      EXPECT_EQ(run.push(pose), PoseVerdict::kAccepted);
      EXPECT_EQ(run.builder.in_stroke(), (buttons & 0b110) != 0);
    }
  };
  move(0, 0.05, 0b001);
  EXPECT_TRUE(run.batches.empty()) << "the wrong button";
  move(0.05, 0.1, 0b010);
  move(0.1, 0.15, 0b000);
  ASSERT_FALSE(run.batches.empty());
  EXPECT_TRUE(run.batches.back().ends_stroke);
  // From the first engaged pose to the first released one: the motion up to the release still cuts.
  EXPECT_NEAR(run.batches.front().lines.front().heel.x, 0.05 + 0.05 / 40, 1e-12);
  EXPECT_NEAR(run.batches.back().lines.back().heel.x, 0.1 + 0.05 / 40, 1e-12);
  move(0.15, 0.2, 0b100);
  run.end();
  run.end();
  EXPECT_EQ(run.batches.back().stroke, 2u);
  EXPECT_FALSE(run.builder.in_stroke());
  expect_well_formed(run.batches);
}

TEST(StrokeBuilder, AStrokeThatNeverMovedIsNone) {
  Recorder run;
  for (int i = 0; i < 100; ++i) run.push(at(i, 0.01));
  run.end();
  EXPECT_TRUE(run.batches.empty());
}

TEST(StrokeBuilder, AJumpOrAGapSweepsNothing) {
  for (const auto& [dt_ms, dx] : {std::pair{5, 0.3}, std::pair{260, 0.0005}}) {
    Recorder run;
    for (int i = 0; i < 60; ++i) run.push(at(2 * i, 0.001 * i));
    EXPECT_EQ(run.push(at(118 + dt_ms, 0.059 + dx)), PoseVerdict::kNewStroke);
    for (int i = 1; i < 60; ++i) run.push(at(118 + dt_ms + 2 * i, 0.059 + dx + 0.001 * i));
    run.end();
    expect_well_formed(run.batches);
    EXPECT_EQ(run.batches.back().stroke, 2u);
    for (const Batch& batch : run.batches) {
      for (std::size_t i = 1; i < batch.lines.size(); ++i) {
        EXPECT_LT(distance(batch.lines[i - 1].heel, batch.lines[i].heel), 0.02);
      }
    }
    EXPECT_TRUE(std::any_of(run.batches.begin(), run.batches.end(), [dx = dx](const Batch& b) {
      return b.stroke == 2 && b.number == 1 && std::abs(b.lines.front().heel.x - 0.059 - dx) < 1e-12;
    }));
  }
}

// The speed limit is for heel and tip: a blade that whips round is a jump, too.
TEST(StrokeBuilder, ATurnThatIsTooFastIsAJump) {
  Recorder run;
  run.push(at(0, 0));
  run.push(at(1, 0.0005));
  EXPECT_EQ(run.push({2 * kMs, {0.001, 0, 0}, about_x(1.5), 0}), PoseVerdict::kNewStroke);
}

TEST(StrokeBuilder, StrokesOfAllSourcesCountTogether) {
  std::uint32_t counter = 0;
  BatchQueue batches;
  StrokeBuilder a(0, config(), kH, counter), b(1, config(), kH, counter);
  a.push(at(0, 0), batches);
  b.push(at(0, 1), batches);
  a.push(at(5, 0.005), batches);
  b.push(at(5, 1.005), batches);
  b.end_stroke(batches);
  a.end_stroke(batches);
  ASSERT_EQ(batches.size(), 2u);
  EXPECT_EQ(batches.segments(), 2u);
  EXPECT_EQ(batches.front().stroke, 2u);
  EXPECT_EQ(batches.front().source, 1u);
  Batch batch;
  batches.pop(batch);
  EXPECT_EQ(batches.front().stroke, 1u);
}

// First in, first out, over many turns of the ring and every length.
TEST(BatchQueue, KeepsOrderAndCountsSegments) {
  Random random(2);
  BatchQueue queue;
  std::deque<std::pair<std::uint32_t, std::size_t>> expected;
  std::uint32_t number = 0;
  std::size_t segments = 0;
  Batch batch;
  for (int i = 0; i < 20000; ++i) {
    if (random.below(i / 1000 % 2 == 0 ? 5 : 3) < 2 && !expected.empty()) {
      EXPECT_EQ(queue.front().number, expected.front().first);
      queue.pop(batch);
      ASSERT_EQ(batch.number, expected.front().first);
      ASSERT_EQ(batch.lines.size(), expected.front().second);
      segments -= batch.lines.size() - 1;
      expected.pop_front();
    } else {
      batch.number = ++number;
      batch.lines.assign(1 + random.below(7), {});
      expected.emplace_back(number, batch.lines.size());
      segments += batch.lines.size() - 1;
      queue.push(batch);
    }
    ASSERT_EQ(queue.size(), expected.size());
    ASSERT_EQ(queue.segments(), segments);
    ASSERT_EQ(queue.empty(), expected.empty());
  }
}

// ---------------------------------------------------------------------------------------------- batches

TEST(StrokeBuilder, ABatchIsOneTravelNotOnePose) {
  Recorder run;
  for (int i = 0; i <= 2000; ++i) run.push(at(i, 0.00005 * i));  // 0.1 m: ten h
  run.end();
  expect_well_formed(run.batches);
  EXPECT_GE(run.batches.size(), 10u);
  EXPECT_LE(run.batches.size(), 11u);
  for (const Batch& batch : run.batches)
    EXPECT_LE(batch.lines.size(), 2u) << "a straight motion needs two lines";
}

TEST(StrokeBuilder, TremblingInPlaceIsBounded) {
  Recorder run;
  Random random(4);
  Pose pose = at(0, 0);
  for (int i = 0; i < 100000; ++i) {
    pose.t_ns += kMs;
    pose.position = random.in_box({-5e-5, -5e-5, -5e-5}, {5e-5, 5e-5, 5e-5});  // 0.005 h: below the tolerance
    ASSERT_EQ(run.push(pose), PoseVerdict::kAccepted);
  }
  run.end();
  expect_well_formed(run.batches);
  std::size_t lines = 0;
  for (const Batch& batch : run.batches) lines += batch.lines.size();
  EXPECT_LE(run.batches.size(), 200u);
  EXPECT_LE(lines, 2 * run.batches.size() + 1);
}

// Noise leads nowhere. What leads away and back is a cut, however much of it there is in a batch.
TEST(StrokeBuilder, KeepsAWayThatLeadsBackToWhereItBegan) {
  CutConfig c = config();
  c.batch_h = 20;
  Recorder run(c);
  for (int i = 0; i <= 200; ++i) {
    ASSERT_EQ(run.push(at(i, 0.001 * (i <= 100 ? i : 200 - i))), PoseVerdict::kAccepted);
  }
  run.end();
  expect_well_formed(run.batches);
  ASSERT_EQ(run.batches.size(), 1u);
  double farthest_m = 0;
  for (const BladeLine& line : run.batches[0].lines) farthest_m = std::max(farthest_m, line.heel.x);
  EXPECT_DOUBLE_EQ(farthest_m, 0.1);
}

// Douglas and Peucker's promise: each blade line that was pushed lies within the tolerance of the batches'
// lines, and within what counts as noise where they are near each other.
TEST(StrokeBuilder, SimplificationStaysWithinTheTolerance) {
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random(seed);
    Recorder run;
    std::vector<BladeLine> pushed;
    Vec3 position, velocity;
    double angle = 0, spin = 0;
    Pose pose;
    for (int i = 0; i < 1500; ++i) {
      pose.t_ns += kMs;
      velocity += random.in_box({-2e-5, -2e-5, -2e-5}, {2e-5, 2e-5, 2e-5});
      if (length(velocity) > 4e-4) velocity = 0.5 * velocity;
      spin = 0.98 * spin + random.uniform(-1e-3, 1e-3);
      position += velocity;
      angle += spin;
      pose.position = position;
      pose.orientation = about_x(angle);
      ASSERT_EQ(run.push(pose), PoseVerdict::kAccepted);
      pushed.push_back(blade_line(config().blade, run.builder.last_pose()));
    }
    run.end();
    expect_well_formed(run.batches);
    std::size_t lines = 0;
    const SweptSurface surface = surface_of(run.batches);
    for (const Batch& batch : run.batches) lines += batch.lines.size();
    EXPECT_LT(lines, pushed.size() / 2) << "nothing was simplified";
    const double tolerance = config().chord_tolerance_h * kH, noise = 0.08 * kH;
    double worst_end = 0, worst_middle = 0, mean_end = 0;
    for (const BladeLine& line : pushed) {
      const double heel = distance_to(surface, line.heel), tip = distance_to(surface, line.tip);
      worst_end = std::max({worst_end, heel, tip});
      mean_end += (heel + tip) / (2.0 * static_cast<double>(pushed.size()));
      worst_middle = std::max(worst_middle, distance_to(surface, lerp(line.heel, line.tip, 0.5)));
    }
    EXPECT_LE(worst_end, 1.01 * noise);
    EXPECT_LE(worst_middle, noise + 2 * tolerance) << "the ends' errors, and the twist's";
    EXPECT_LE(mean_end, tolerance);
  }
}

TEST(StrokeBuilder, KeepsPosesThatTheTwistNeeds) {
  Recorder run;
  // Heel and tip both move straight, but not in one plane: to a polyline's eye two poses would do.
  CutConfig c = config();
  std::vector<BladeLine> lines;
  for (int i = 0; i <= 100; ++i) {
    const double s = i / 100.0;
    run.push({i * kMs, {0.008 * s, 0, 0}, about_x(0.08 * s), 0});
  }
  run.end();
  for (const Batch& batch : run.batches) {
    EXPECT_GT(batch.lines.size(), 2u);
    for (std::size_t i = 1; i < batch.lines.size(); ++i) {
      const BladeLine &a = batch.lines[i - 1], &b = batch.lines[i];
      EXPECT_LE(0.25 * length((b.tip - b.heel) - (a.tip - a.heel)), c.chord_tolerance_h * kH);
    }
  }
}

// How finely the motion is sampled must not matter: the surfaces of 2, 10, 200 and 5,000 poses.
TEST(StrokeBuilder, TheSurfaceDoesNotDependOnTheNumberOfPoses) {
  using Motion = std::function<Pose(double)>;
  const std::vector<std::pair<const char*, Motion>> motions{
      {"straight",
       [](double s) {
         return Pose{0, {0.1 * s, 0.01 * s, 0}, {}, 0};
       }},
      {"tilted",
       [](double s) {
         return Pose{0, {0.1 * s, 0, 0}, about_x(0.4), 0};
       }},
      {"turning about the heel",
       [](double s) {
         return Pose{0, {}, about_x(0.8 * s), 0};
       }},
      {"curved",
       [](double s) {
         return Pose{0, {0.1 * s, 0.02 * std::sin(3 * s), 0}, {}, 0};
       }},
      {"twisted",
       [](double s) {
         return Pose{0, {0.1 * s, 0, 0}, about_x(0.6 * s), 0};
       }},
  };
  for (const auto& [name, motion] : motions) {
    SCOPED_TRACE(name);
    const bool straight = name == std::string("straight") || name == std::string("tilted");
    std::vector<SweptSurface> surfaces;
    for (int poses : {2, 10, 200, 5000}) {
      if (poses < 200 && !straight) continue;  // a curve in ten poses is another curve
      CutConfig c = config();
      c.speed_limit_m_s = 100;
      Recorder run(c);
      for (int i = 0; i < poses; ++i) {
        Pose pose = motion(static_cast<double>(i) / (poses - 1));
        pose.t_ns = 200 * kMs * i / (poses - 1);
        ASSERT_EQ(run.push(pose), PoseVerdict::kAccepted);
      }
      run.end();
      expect_well_formed(run.batches);
      surfaces.push_back(surface_of(run.batches));
    }
    const double tolerance = 2.5 * config().chord_tolerance_h * kH;
    for (const SweptSurface& a : surfaces) {
      for (const SweptSurface& b : surfaces) {
        double worst = 0;
        for (const SweptTriangle& t : a.triangles()) {
          for (const Vec3& p : t.corners) worst = std::max(worst, distance_to(b, p));
        }
        EXPECT_LE(worst, straight ? 1e-12 : tolerance);
      }
    }
  }
}

// A mesh without edges has h = 0, a configuration may ask for no tolerance: neither may hang or divide by
// zero.
TEST(StrokeBuilder, ZeroTolerances) {
  Recorder no_h(config(), 0);
  CutConfig exact = config();
  exact.chord_tolerance_h = 0;
  Recorder no_tolerance(exact);
  for (int i = 0; i < 2000; ++i) {
    const Pose pose{i * kMs, {0.0001 * i, 0.00001 * (i % 7), 0}, about_x(0.0001 * i), 0};
    EXPECT_EQ(no_h.push(pose), PoseVerdict::kAccepted);
    EXPECT_EQ(no_tolerance.push(pose), PoseVerdict::kAccepted);
  }
  no_h.end();
  no_tolerance.end();
  expect_well_formed(no_h.batches);
  expect_well_formed(no_tolerance.batches);
  std::size_t lines = 0;
  for (const Batch& batch : no_tolerance.batches) lines += batch.lines.size() - 1;
  EXPECT_GE(lines, 1990u) << "without a tolerance nearly every pose counts";
}

TEST(StrokeBuilder, VerdictsHaveNames) {
  for (int i = 0; i < kPoseVerdicts; ++i) EXPECT_STRNE(to_string(static_cast<PoseVerdict>(i)), "?");
}

}  // namespace
}  // namespace incise::core
