#include "server/core/cut/conforming/stroke_path.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

namespace incise::core {
namespace {

constexpr double kH = 0.01;  // m

BladeLine upright(double x, double y) {
  return {{x, y, -0.05}, {x, y, 0.05}};
}

std::vector<Batch> batches_of(const std::vector<BladeLine>& lines, std::size_t count) {
  std::vector<Batch> batches;
  for (std::size_t first = 0; first + 1 < lines.size(); first += count) {
    const std::size_t last = std::min(first + count, lines.size() - 1);
    Batch batch;
    batch.number = static_cast<std::uint32_t>(batches.size());
    batch.lines.assign(lines.begin() + static_cast<std::ptrdiff_t>(first),
                       lines.begin() + static_cast<std::ptrdiff_t>(last) + 1);
    batch.ends_stroke = last + 1 == lines.size();
    batches.push_back(batch);
  }
  return batches;
}

// Takes the lines in batches of `count` segments; where the blade turns sharply, as soon as it is known.
std::vector<BladeLine> turns_of(const std::vector<BladeLine>& lines, std::size_t count) {
  const CutConfig config;
  StrokePath path(config, kH);
  WorkMeter work;
  std::vector<BladeLine> turns;
  for (const Batch& batch : batches_of(lines, count)) {
    path.add(batch, {{-1, -1, -1}, {1, 1, 1}, true}, work);
    turns.insert(turns.end(), path.late_turns().begin(), path.late_turns().end());
    for (std::size_t i = path.first_latest(); i < path.surface().size(); ++i) {
      const SweptTriangle& t = path.surface()[i];
      if ((t.rim & SweptTriangle::kTurns) == 0) continue;
      const BladeLine line = upright(t.corners[0].x, t.corners[0].y);
      if (turns.empty() || turns.back().heel != line.heel) turns.push_back(line);
    }
  }
  return turns;
}

// From one corner to the next in steps of 0.2 h.
std::vector<BladeLine> along(const std::vector<std::pair<double, double>>& corners_h) {
  std::vector<BladeLine> lines;
  for (std::size_t k = 0; k + 1 < corners_h.size(); ++k) {
    const auto [x, y] = corners_h[k];
    const auto [x2, y2] = corners_h[k + 1];
    const int steps = static_cast<int>(std::lround(std::hypot(x2 - x, y2 - y) / 0.2));
    for (int i = k == 0 ? 0 : 1; i <= steps; ++i) {
      const double s = static_cast<double>(i) / steps;
      lines.push_back(upright(kH * std::lerp(x, x2, s), kH * std::lerp(y, y2, s)));
    }
  }
  return lines;
}

TEST(StrokePathTurns, CornersAreFoundWhereTheyAreInBatchesOfAnySize) {
  const auto lines = along({{0, 0}, {3, 0}, {3, 2}, {1, 2}, {1, 1}});
  for (const std::size_t count : {1, 2, 7, 1000}) {
    const auto turns = turns_of(lines, count);
    ASSERT_EQ(turns.size(), 3u) << count;
    EXPECT_NEAR(turns[0].heel.x, 3 * kH, 1e-9) << count;
    EXPECT_NEAR(turns[0].heel.y, 0, 1e-9) << count;
    EXPECT_NEAR(turns[1].heel.x, 3 * kH, 1e-9) << count;
    EXPECT_NEAR(turns[1].heel.y, 2 * kH, 1e-9) << count;
    EXPECT_NEAR(turns[2].heel.x, kH, 1e-9) << count;
    EXPECT_NEAR(turns[2].heel.y, 2 * kH, 1e-9) << count;
  }
}

TEST(StrokePathTurns, ATrembleIsNone) {
  std::vector<BladeLine> lines;
  for (int i = 0; i <= 400; ++i) {
    const double off_h = 0.04 * (i % 2 == 0 ? 1 : -1);
    lines.push_back(upright(kH * 0.03 * i, kH * off_h));
  }
  EXPECT_TRUE(turns_of(lines, 5).empty());
}

TEST(StrokePathTurns, AWideArcIsNoneAndATightOneIsFollowed) {
  const auto arc = [](double radius_h) {
    std::vector<BladeLine> lines;
    for (double angle = 0; angle < std::numbers::pi; angle += 0.1 / radius_h) {
      lines.push_back(upright(kH * radius_h * std::sin(angle), kH * radius_h * (1 - std::cos(angle))));
    }
    return lines;
  };
  EXPECT_TRUE(turns_of(arc(8), 4).empty());
  EXPECT_GE(turns_of(arc(0.5), 4).size(), 2u);
}

// A blade that goes along `lines`, in batches of `count` segments. The body does not move.
void go(StrokePath& path, const std::vector<BladeLine>& lines, std::size_t count) {
  WorkMeter work;
  const Box tissue{{-1, -1, -1}, {1, 1, 1}};
  for (const Batch& batch : batches_of(lines, count)) {
    path.add(batch, {tissue.low, tissue.high}, work);
    path.build(tissue);
  }
}

// Round a square, and on over its own beginning: wherever the poses lie there, no slit is left.
TEST(StrokePathRetraces, WithoutASlitWhereItComesUponItsOwnSweep) {
  for (const double step_h : {0.02, 0.05, 0.13}) {
    for (const double from_h : {0.0, 0.03, 0.07, 0.11}) {
      for (const std::size_t count : {1, 4}) {
        std::vector<BladeLine> lines = along({{0, 0}, {3, 0}, {3, 3}, {-3, 3}, {-3, 0}});
        for (double x_h = -2.9 + from_h; x_h < 1; x_h += step_h) lines.push_back(upright(kH * x_h, 0));
        const CutConfig config;
        StrokePath path(config, kH);
        go(path, lines, count);
        for (double x_h = -1; x_h < 1; x_h += 0.005) {
          const Vec3 p{kH * x_h, 0, 0.013};
          EXPECT_TRUE(path.surface().is_within(p, 1e-6 * kH)) << x_h << ": " << step_h << ", " << from_h;
        }
      }
    }
  }
}

// The triangles that two batches of `count` segments add, which look at the surface as it was before them: of three cells a segment.
std::size_t of_two_batches(std::size_t count) {
  return 2 * 6 * count;
}

// Out over the rim of its own sweep and back, less far than what counts as swept: next to nothing is added, however often.
TEST(StrokePathRetraces, WithoutSweepingWhatItLeavesByLittle) {
  std::vector<BladeLine> lines = along({{0, 0}, {3, 0}});
  const CutConfig config;
  StrokePath path(config, kH);
  go(path, lines, 3);
  const std::size_t before = path.surface().size();
  lines.clear();
  for (int i = 0; i < 300; ++i) lines.push_back(upright(kH * (2.9 + 0.14 * std::sin(0.2 * i)), 0));
  go(path, lines, 3);
  EXPECT_LE(path.surface().size(), before + of_two_batches(3));
}

TEST(StrokePathRetraces, WithoutSweepingItAgain) {
  const auto once = along({{0, 0}, {3, 0}, {3, 3}, {0, 3}});
  const auto again = along({{0, 0}, {3, 0}, {3, 3}, {0, 3}, {3, 3}, {3, 0}, {0, 0}, {3, 0}});
  for (const std::size_t count : {1, 4}) {
    const CutConfig config;
    StrokePath path(config, kH), longer(config, kH);
    go(path, once, count);
    go(longer, again, count);
    EXPECT_LE(longer.surface().size(), path.surface().size() + of_two_batches(count));
  }
}

TEST(StrokePathTurns, StraightBackIsNone) {
  EXPECT_TRUE(turns_of(along({{0, 0}, {4, 0}, {1, 0}, {5, 0}}), 3).empty());
}

}  // namespace
}  // namespace incise::core
