#include "server/core/cut/swept_memory.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "server/core/stroke/swept_triangle.hpp"

namespace incise::core {
namespace {

const Box kTissue{{-0.5, -0.5, -0.5}, {0.5, 0.5, 0.5}};

// A blade along z that has come along x to `x`.
BladeLine line_at(double x) {
  return {{x, 0, -1}, {x, 0, 1}};
}

// A blade along z at (x, y).
BladeLine line_at(double x, double y) {
  return {{x, y, -1}, {x, y, 1}};
}

TEST(SweptMemory, KeepsChordsOfWhatWasSwept) {
  SweptMemory memory;
  const std::vector<BladeLine> lines{line_at(0), line_at(0.1), line_at(0.2), line_at(0.2, 0.1),
                                     line_at(0.2, 0.15)};
  memory.add(lines, 7, 5, 0.15, kTissue);
  ASSERT_EQ(memory.quads().size(), 2u);
  EXPECT_EQ(memory.quads()[0].from, line_at(0));
  EXPECT_EQ(memory.quads()[0].to, line_at(0.2));
  EXPECT_EQ(memory.quads()[0].travel_m, 5);
  // The rest, though it is shorter.
  EXPECT_EQ(memory.quads()[1].from, line_at(0.2));
  EXPECT_EQ(memory.quads()[1].to, line_at(0.2, 0.15));
  EXPECT_EQ(memory.quads()[1].travel_m, 5.2);
  EXPECT_EQ(memory.quads()[1].stroke, 7u);
  EXPECT_TRUE(memory.quads()[1].has_rims);
}

TEST(SweptMemory, GoesOnWhereTheWayIsStraight) {
  constexpr double kChord = 1 / 64.0;
  SweptMemory memory;
  // Two blades take turns, and theirs go on across batches to five chords at most.
  for (int i = 0; i < 20; ++i) {
    const double x = i / 128.0, to = (i + 1) / 128.0;
    memory.add(std::vector{line_at(x), line_at(to)}, 1, x, kChord, kTissue);
    memory.add(std::vector{line_at(x, 0.25), line_at(to, 0.25)}, 2, x, kChord, kTissue);
  }
  ASSERT_EQ(memory.quads().size(), 4u);
  EXPECT_EQ(memory.quads()[0].to.tip.x, 5 * kChord);
  EXPECT_EQ(memory.quads()[2].from, memory.quads()[0].to);
  EXPECT_EQ(memory.quads()[2].travel_m, 5 * kChord);
  EXPECT_EQ(memory.quads()[2].to.tip.x, 10 * kChord);
  EXPECT_EQ(memory.quads()[2].rims[SweptMemory::kTip].parts, 5) << "as long as the chords";
  // Back along itself: that is no longer way.
  memory.add(std::vector{line_at(10 * kChord), line_at(8 * kChord)}, 1, 10 * kChord, kChord, kTissue);
  EXPECT_EQ(memory.quads().size(), 5u);
}

TEST(SweptMemory, StaysNearAWayThatBends) {
  constexpr double kRadius = 0.4, kChord = 0.02, kStep = 0.001;
  const auto on_circle = [](double way) {
    return line_at(kRadius * std::sin(way / kRadius), kRadius * (1 - std::cos(way / kRadius)));
  };
  SweptMemory memory;
  const int steps = 500;
  for (int i = 0; i < steps; ++i)
    memory.add(std::vector{on_circle(i * kStep), on_circle((i + 1) * kStep)}, 1, i * kStep, kChord, kTissue);
  EXPECT_LT(memory.quads().size(), steps / 10u);
  double most_m = 0;
  for (int i = 0; i <= steps; ++i) {
    double least_m = 1;
    for (const SweptMemory::Quad& quad : memory.quads()) {
      for (const auto& [a, b, c] : quad.triangles()) {
        const Vec3 p = on_circle(i * kStep).tip;
        least_m = std::min(least_m, distance(p, closest_point(p, a, b, c)));
      }
    }
    most_m = std::max(most_m, least_m);
  }
  EXPECT_LE(most_m, 0.1 * kChord);
}

TEST(SweptMemory, DoesNotGoOnWhereALaterSweepHasTakenUpARim) {
  SweptMemory memory;
  memory.add(std::vector{line_at(0), line_at(0.01)}, 1, 0, 0.1, kTissue);
  memory.take(0, SweptMemory::kTip, 0);
  memory.add(std::vector{line_at(0.01), line_at(0.02)}, 1, 0.01, 0.1, kTissue);
  EXPECT_EQ(memory.quads().size(), 2u);
}

TEST(SweptMemory, KeepsNothingOfABladeThatRests) {
  SweptMemory memory;
  memory.add(std::vector<BladeLine>{line_at(0), line_at(0), line_at(0)}, 1, 0, 0.1, kTissue);
  memory.add(std::vector<BladeLine>{line_at(0)}, 1, 0, 0.1, kTissue);
  EXPECT_TRUE(memory.quads().empty());
}

TEST(SweptMemory, KeepsNothingOfABladeInTheAir) {
  SweptMemory memory;
  memory.add(std::vector<BladeLine>{line_at(2), line_at(1), line_at(0), line_at(-1), line_at(-2)}, 1, 0, 0.5,
             kTissue);
  ASSERT_EQ(memory.quads().size(), 1u);
  EXPECT_EQ(memory.quads()[0].from, line_at(1));
  EXPECT_EQ(memory.quads()[0].travel_m, 1);
  EXPECT_EQ(memory.quads()[0].to, line_at(-1));
}

TEST(SweptMemory, ForgetsTheOldest) {
  SweptMemory memory;
  for (std::uint32_t i = 1; i <= 6000; ++i) memory.add({line_at(0), line_at(1), i, 0, true});
  ASSERT_EQ(memory.quads().size(), 4096u);
  std::vector<bool> kept(6001, false);
  for (const SweptMemory::Quad& quad : memory.quads()) kept[quad.stroke] = true;
  for (std::uint32_t i = 1; i <= 6000; ++i) EXPECT_EQ(kept[i], i > 1904) << i;
}

// The numbers of the quads that may have a free rim in a box.
std::vector<std::size_t> with_free_rim(const SweptMemory& memory, const Box& box) {
  std::vector<std::size_t> all;
  std::size_t looked_at = 0;
  for (std::size_t i = 0; (i = memory.next_with_free_rim(i, box, looked_at)) < memory.quads().size(); ++i)
    all.push_back(i);
  EXPECT_LE(looked_at, memory.quads().size() / 16 + 2 * all.size() + 1) << "it goes by blocks";
  return all;
}

TEST(SweptMemory, FindsTheRimsInTheTissueThatAreFree) {
  SweptMemory memory;
  const Box above{{-9, -9, 0.9}, {9, 9, 1.1}}, below{{-9, -9, -1.1}, {9, 9, -0.9}};
  memory.add(std::vector<BladeLine>{line_at(0), line_at(0.2), line_at(0.2, 0.2)}, 1, 0, 0.1, above);
  EXPECT_EQ(with_free_rim(memory, above), (std::vector<std::size_t>{0, 1})) << "the tip's ways";
  EXPECT_TRUE(with_free_rim(memory, below).empty()) << "the heel's are out of the tissue";
  ASSERT_EQ(memory.quads()[0].rims[SweptMemory::kTip].parts, 2) << "as long as the chords";
  memory.take(0, SweptMemory::kTip, 0);
  EXPECT_EQ(with_free_rim(memory, above), (std::vector<std::size_t>{0, 1})) << "half of the first one";
  memory.take(0, SweptMemory::kTip, 1);
  EXPECT_EQ(with_free_rim(memory, above), std::vector<std::size_t>{1});
  memory = {};
  EXPECT_TRUE(with_free_rim(memory, above).empty());
}

TEST(SweptMemory, FindsFreeRimsAmongManyAndAfterOldOnesAreForgotten) {
  SweptMemory memory;
  for (std::uint32_t i = 0; i < 6000; ++i)
    memory.add({line_at(i), line_at(i + 0.5), i + 1, 0, true, 0, {{{}, {1, i % 100 == 0 ? 1u : 0u}}}, {}});
  const auto around = [](double x) { return Box{{x - 0.1, -9, -9}, {x + 0.1, 9, 9}}; };
  const auto strokes_near = [&](double x) {
    std::vector<std::uint32_t> strokes;
    for (std::size_t i : with_free_rim(memory, around(x))) strokes.push_back(memory.quads()[i].stroke);
    return strokes;
  };
  EXPECT_EQ(strokes_near(5900), std::vector<std::uint32_t>{5901});
  EXPECT_EQ(strokes_near(2000), std::vector<std::uint32_t>{2001});
  EXPECT_TRUE(strokes_near(1900).empty()) << "forgotten";
}

// A long blade that lies along no axis, and goes around: boxes around its way let nearly all of it through.
TEST(SweptMemory, FindsWhatALongSlantedBladeSweptWithoutLookingAtAllOfIt) {
  const Vec3 along = normalized(Vec3{1, 1.2, 0.8}), side = normalized(cross(along, Vec3{0, 0, 1}));
  const Vec3 up = cross(along, side);
  std::vector<BladeLine> lines;
  for (int i = 0; i <= 1500; ++i) {
    const double angle = 0.02 * i, radius = 0.1 + 0.0002 * i;
    const Vec3 at = radius * (std::cos(angle) * side + std::sin(angle) * up) + 0.0001 * i * along;
    lines.push_back({at - 2 * along, at + 2 * along});
  }
  SweptMemory memory;
  memory.add(lines, 1, 0, 0.001, {{-3, -3, -3}, {3, 3, 3}});
  ASSERT_GT(memory.quads().size(), 1000u);

  std::mt19937_64 random(5);
  const auto anywhere = [&] { return static_cast<double>(random() >> 11) * 0x1p-53 - 0.5; };
  const auto side_of = [](const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& p) {
    return dot(cross(b - a, c - a), p - a) > 0;
  };
  std::size_t looked_at = 0, visited = 0, crossed = 0, near = 0;
  constexpr std::size_t kSegments = 1000;
  for (std::size_t n = 0; n < kSegments; ++n) {
    const Vec3 a{anywhere(), anywhere(), anywhere()};
    const Vec3 b = a + 0.05 * Vec3{anywhere(), anywhere(), anywhere()};
    bool crosses = false, is_near = false;
    for (const SweptMemory::Quad& quad : memory.quads()) {
      for (const auto& [p, q, r] : quad.triangles()) {
        const bool inside =
            side_of(a, b, p, q) == side_of(a, b, q, r) && side_of(a, b, q, r) == side_of(a, b, r, p);
        crosses = crosses || (inside && side_of(p, q, r, a) != side_of(p, q, r, b));
      }
      is_near = is_near || quad.squared_distance(a) <= 0.005 * 0.005;
    }
    EXPECT_EQ(memory.crosses(a, b, looked_at), crosses) << "segment " << n;
    std::size_t others = 0;
    EXPECT_EQ(memory.stroke_at(a, 0.005, others) != 0, is_near) << "point " << n;
    memory.any_in(Box::around({a, b}), others, [&](const SweptMemory::Quad&) {
      ++visited;
      return false;
    });
    crossed += crosses ? 1 : 0;
    near += is_near ? 1 : 0;
  }
  EXPECT_GT(crossed, 50u);
  EXPECT_GT(near, 50u);
  // Sixteen quads are a block. All blocks, and a tenth of the quads.
  EXPECT_LT(looked_at, kSegments * (memory.quads().size() / 16 + 1 + memory.quads().size() / 10));
  // Of those, few are visited: boxes alone let through 4 times as many.
  EXPECT_LT(visited, kSegments);
}

TEST(SweptMemory, ComesBackAsItWasSaved) {
  SweptMemory memory;
  memory.lack_what_was_before();
  for (std::uint32_t i = 1; i <= 4200; ++i)
    memory.add({line_at(i), line_at(i + 1), i, 0.5 * i, i % 2 == 0, 0.25 * i, {{{3, i % 8}, {64, i}}}, {}});
  Archive out;
  memory.archive(out);
  const auto bytes = out.take();
  SweptMemory back;
  Archive in(bytes);
  back.archive(in);
  ASSERT_FALSE(in.failed()) << in.error();
  EXPECT_FALSE(back.is_whole());
  // Whatever comes next takes the same place.
  for (SweptMemory* one : {&memory, &back}) one->add({line_at(0), line_at(1), 9999, 0, false});
  ASSERT_EQ(back.quads().size(), memory.quads().size());
  for (std::size_t i = 0; i < back.quads().size(); ++i) {
    EXPECT_EQ(back.quads()[i].stroke, memory.quads()[i].stroke) << i;
    EXPECT_EQ(back.quads()[i].to, memory.quads()[i].to) << i;
    EXPECT_EQ(back.quads()[i].travel_m, memory.quads()[i].travel_m) << i;
    EXPECT_EQ(back.quads()[i].off_m, memory.quads()[i].off_m) << i;
    EXPECT_EQ(back.quads()[i].has_rims, memory.quads()[i].has_rims) << i;
    for (auto end : {SweptMemory::kHeel, SweptMemory::kTip}) {
      EXPECT_EQ(back.quads()[i].rims[end].parts, memory.quads()[i].rims[end].parts) << i;
      EXPECT_EQ(back.quads()[i].rims[end].free, memory.quads()[i].rims[end].free) << i;
    }
  }

  // A place that it does not have.
  auto damaged = bytes;
  damaged[1] = std::byte{0x20};
  SweptMemory refused;
  Archive bad(damaged);
  refused.archive(bad);
  EXPECT_EQ(bad.error(), "the oldest quad of those that were swept is none");
  EXPECT_TRUE(refused.quads().empty());
}

}  // namespace
}  // namespace incise::core
