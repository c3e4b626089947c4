#include "server/core/stroke/affine_motion.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using testing::Random;

constexpr double kNear = 1e-3;

Vec3 random_place(Random& random) {
  return {random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)};
}

// A turn, a strain and a way.
Vec3 there(const Vec3& p) {
  const Vec3 q = rotate({std::cos(0.6), 0, std::sin(0.6), 0}, p);
  return Vec3{1.1 * q.x + 0.2 * q.y, 0.9 * q.y, q.z - 0.1 * q.x} + Vec3{3, 2, 1};
}

TEST(AffineMotion, TakesPointsAndWhatIsAcrossAPlaneAlong) {
  constexpr std::uint64_t kSeed = 5;
  Random random(kSeed);
  std::vector<Vec3> from, to;
  for (int i = 0; i < 40; ++i) from.push_back(random_place(random));
  for (const Vec3& p : from) to.push_back(there(p));
  const AffineMotion motion = AffineMotion::fit(from, to);
  EXPECT_TRUE(motion.moves());
  for (int i = 0; i < 40; ++i) {
    const Vec3 a = random_place(random), b = random_place(random), c = random_place(random);
    EXPECT_LT(distance(motion(a), there(a)), kNear) << "seed " << kSeed;
    // What is flat stays so, to the last bits.
    const Vec3 amid = 0.2 * a + 0.3 * b + 0.5 * c;
    EXPECT_LT(distance(motion(amid), 0.2 * motion(a) + 0.3 * motion(b) + 0.5 * motion(c)), 1e-14);
    const Vec3 across = normalized(cross(motion(b) - motion(a), motion(c) - motion(a)));
    EXPECT_NEAR(dot(motion.turn_normal(normalized(cross(b - a, c - a))), across), 1, 1e-9);
    EXPECT_NEAR(dot(motion.turn(b - a), normalized(motion(b) - motion(a))), 1, 1e-12);
  }
  const AffineMotion none = motion.part(0);
  EXPECT_LT(distance(none(from[0]), from[0]), 1e-14);
  EXPECT_LT(distance(motion.part(1)(from[0]), motion(from[0])), 1e-14);
}

// Nothing is known across them.
TEST(AffineMotion, PointsInAPlaneALineOrAPlaceAreNotStrainedAcross) {
  Random random(6);
  std::vector<Vec3> from, to;
  for (int i = 0; i < 20; ++i) from.push_back({random.uniform(-1, 1), random.uniform(-1, 1), 0});
  for (const Vec3& p : from) to.push_back({1.2 * p.x, p.y, 0.5});
  const AffineMotion in_a_plane = AffineMotion::fit(from, to);
  EXPECT_LT(distance(in_a_plane(Vec3{1, 1, 1}), Vec3{1.2, 1, 1.5}), 4e-3);
  const std::vector<Vec3> line{{0, 0, 0}, {0, 0, 1}, {0, 0, 2}}, longer{{1, 0, 0}, {1, 0, 1.2}, {1, 0, 2.4}};
  const AffineMotion in_a_line = AffineMotion::fit(line, longer);
  EXPECT_LT(distance(in_a_line(Vec3{0.5, 0.5, 2}), Vec3{1.5, 0.5, 2.4}), 4e-3);
  const std::vector<Vec3> place{{1, 2, 3}}, other{{1, 2, 4}};
  EXPECT_EQ(AffineMotion::fit(place, other)(Vec3{5, 5, 5}), (Vec3{5, 5, 6}));
  EXPECT_FALSE(AffineMotion::fit({}, {}).moves());
}

// Positions of a solver that has diverged.
TEST(AffineMotion, NoStrainIsLargerThanTissueMayHave) {
  const std::vector<Vec3> from{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  std::vector<Vec3> to;
  for (const Vec3& p : from) to.push_back(1e6 * p);
  const AffineMotion motion = AffineMotion::fit(from, to);
  EXPECT_NEAR(distance(motion(from[0]), motion(from[1])), 1, 1e-9);
}

}  // namespace
}  // namespace incise::core
