#include "server/core/stroke/swept_tree.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "server/core/stroke/swept_surface.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using testing::Random;

// A hand that wanders about a place: the blade turns, goes to and fro and crosses what it has swept before.
class Wandering {
 public:
  explicit Wandering(std::uint64_t seed, const Vec3& place) : random_(seed), place_(place) {}
  BladeLine next() {
    at_ += 0.05;
    const auto sway = [&](double rate) { return std::sin(rate * at_) + 0.05 * random_.uniform(-1, 1); };
    const Vec3 heel = place_ + Vec3{0.4 * sway(1.0), 0.3 * sway(1.7), 0.2 * sway(0.6)};
    const Vec3 along = normalized(Vec3{0.5 * sway(0.9), 0.4 * sway(2.3), 1});
    return {heel, heel + 1.5 * along};
  }
  Vec3 near() {
    return place_ + Vec3{random_.uniform(-1, 1), random_.uniform(-1, 1), random_.uniform(-0.5, 2)};
  }
  std::size_t below(std::size_t n) { return random_.below(static_cast<std::uint32_t>(n)); }
  double uniform(double low, double high) { return random_.uniform(low, high); }

 private:
  Random random_;
  Vec3 place_;
  double at_ = 0;
};

void sweep(SweptSurface& surface, Wandering& hand, BladeLine& last, std::uint32_t batch) {
  const BladeLine line = hand.next();
  surface.add_quad(last, line, 2, 5, batch, false);
  last = line;
}

std::vector<std::uint32_t> visited(const SweptTree& tree, const std::array<Vec3, 4>& points, double slack) {
  std::vector<std::uint32_t> found;
  tree.any_between(FourPoints(points), slack, [&](std::uint32_t i) {
    found.push_back(i);
    return false;
  });
  return found;
}

// Far from the origin, too, where floats are coarse.
const Vec3 kPlaces[] = {{0, 0, 0}, {30, -50, 80}};

TEST(SweptTree, MissesNothingThatIsCrossedOrNear) {
  for (const Vec3& place : kPlaces) {
    Wandering hand(1, place);
    SweptSurface surface;
    BladeLine last = hand.next();
    for (std::uint32_t batch = 1; batch <= 90; ++batch) sweep(surface, hand, last, batch);
    ASSERT_GT(surface.size(), 1000u);  // more levels than have planes
    SweptTree tree;
    tree.build(surface.triangles(), 0, 0);
    std::size_t crossed = 0, visits = 0, near = 0;
    for (int round = 0; round < 400; ++round) {
      const Vec3 p = lerp(hand.near(), surface[hand.below(surface.size())].corners[0], 0.9);
      std::array<Vec3, 4> points;
      for (Vec3& q : points)
        q = p + 0.1 * Vec3{hand.uniform(-1, 1), hand.uniform(-1, 1), hand.uniform(-1, 1)};
      const double slack = round % 2 == 0 ? 1e-9 : 0.02;
      const std::vector<std::uint32_t> found = visited(tree, points, slack);
      EXPECT_TRUE(std::is_sorted(found.begin(), found.end()));
      visits += found.size();
      // All that an edge between two of the points crosses, and all that is as near to one as the slack.
      for (std::uint32_t i = 0; i < surface.size(); ++i) {
        bool must = false;
        for (const auto& edge : {std::pair{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}})
          must = must || crosses(points[edge.first], points[edge.second], surface[i]);
        for (const Vec3& q : points)
          must = must || (slack > 1e-6 && distance(closest_point(q, surface[i]), q) < slack);
        if (!must) continue;
        ++crossed;
        EXPECT_TRUE(std::binary_search(found.begin(), found.end(), i)) << round << ": triangle " << i;
      }
      const double reach = hand.uniform(0.01, 0.3);
      double least = reach * reach;
      for (const SweptTriangle& triangle : surface.triangles())
        least = std::min(least, squared_length(closest_point(p, triangle) - p));
      double best = reach * reach;
      tree.each_near(p, best, [&](std::uint32_t i) {
        best = std::min(best, squared_length(closest_point(p, surface[i]) - p));
        ++near;
      });
      EXPECT_DOUBLE_EQ(best, least) << round;
    }
    EXPECT_GT(crossed, 1000u);
    // What boxes along the axes alone let through is several times as much.
    std::size_t boxes = 0;
    for (int round = 0; round < 400; ++round) {
      const Vec3 p = lerp(hand.near(), surface[hand.below(surface.size())].corners[0], 0.9);
      const Vec3 by{0.1, 0.1, 0.1};
      const Vec3 low = p - by, high = p + by;
      for (const SweptTriangle& t : surface.triangles()) {
        boxes += t.low.x <= high.x && t.high.x >= low.x && t.low.y <= high.y && t.high.y >= low.y &&
                 t.low.z <= high.z && t.high.z >= low.z;
      }
    }
    EXPECT_LT(2 * visits, boxes);
    EXPECT_LT(near, 400 * surface.size() / 20);
  }
}

TEST(SweptTree, IsTheSameBuiltStepByStep) {
  Wandering hand(2, {});
  SweptSurface surface;
  BladeLine last = hand.next();
  SweptTree grown;
  EXPECT_TRUE(grown.empty());
  std::size_t same = 0;
  for (std::uint32_t batch = 1; batch <= 60; ++batch) {
    sweep(surface, hand, last, batch);
    grown.build(surface.triangles(), 0, same);
    same = surface.size();
    SweptTree fresh;
    fresh.build(surface.triangles(), 0, 0);
    for (int round = 0; round < 20; ++round) {
      std::array<Vec3, 4> points;
      for (Vec3& q : points) q = hand.near();
      EXPECT_EQ(visited(grown, points, 0.01), visited(fresh, points, 0.01)) << batch;
    }
  }
  grown.build({}, 0, 0);
  EXPECT_TRUE(grown.empty());
  EXPECT_TRUE(visited(grown, {hand.near(), hand.near(), hand.near(), hand.near()}, 1).empty());
}

// The surface drops what is too old, so that what is left stands elsewhere in the list.
TEST(SweptSurface, FindsWhatIsLeftAfterDropping) {
  Wandering hand(3, {});
  SweptSurface surface;
  BladeLine last = hand.next();
  for (std::uint32_t batch = 1; batch <= 60; ++batch) {
    const std::size_t before = surface.size();
    sweep(surface, hand, last, batch);
    const std::size_t dropped = batch > 10 && batch % 5 == 0 ? surface.drop_before(batch - 10) : 0;
    surface.build(before - dropped);
    for (int round = 0; round < 10; ++round) {
      const Vec3 p = hand.near();
      double least = INFINITY;
      for (const SweptTriangle& triangle : surface.triangles())
        least = std::min(least, distance(closest_point(p, triangle), p));
      Vec3 point;
      std::uint32_t triangle = 0;
      ASSERT_TRUE(surface.closest(p, 100, point, triangle));
      EXPECT_DOUBLE_EQ(distance(point, p), least);
      // One that is known to be near makes no difference, unless it is forgotten.
      for (std::uint32_t likely : {triangle, static_cast<std::uint32_t>(hand.below(surface.size() + 9))}) {
        Vec3 same;
        std::uint32_t same_triangle = 0;
        ASSERT_TRUE(surface.closest(p, 100, same, same_triangle, likely));
        EXPECT_EQ(same, point);
        EXPECT_EQ(same_triangle, triangle);
      }
      std::uint32_t first = UINT32_MAX;
      surface.any_latest_between(Points<2>({p, p}), 100, [&](std::uint32_t i) {
        first = std::min(first, i);
        return false;
      });
      EXPECT_EQ(first, before - dropped);
    }
  }
}

}  // namespace
}  // namespace incise::core
