#include "server/core/stroke/swept_surface.hpp"

#include <gtest/gtest.h>

#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

// A slanted plane, swept forth and back in steps of all lengths.
class Slanted {
 public:
  Vec3 at(double ahead, double along) const { return middle_ + ahead * ahead_ + along * along_; }
  BladeLine line(double ahead) const { return {at(ahead, -1), at(ahead, 1.3)}; }
  Vec3 normal() const { return normal_; }
  void sweep(SweptSurface& surface) const {
    const double steps[] = {0, 0.1, 0.13, 1, 0.4, 2};
    for (std::uint32_t i = 1; i < 6; ++i)
      surface.add_quad(line(steps[i - 1]), line(steps[i]), 3, 4, i, i == 1);
    surface.build();
  }

 private:
  Vec3 normal_ = normalized({0.31, 0.17, 1}), middle_{0.2, -0.1, 0.5};
  Vec3 along_ = normalized(cross(normal_, {1, 0, 0})), ahead_ = cross(normal_, along_);
};

TEST(SweptSurface, OfAStraightSweepIsFlat) {
  const Slanted plane;
  SweptSurface surface;
  EXPECT_EQ(surface.flat(1), nullptr);
  plane.sweep(surface);
  ASSERT_NE(surface.flat(1e-12), nullptr);
  testing::Random random(7);
  for (int i = 0; i < 1000; ++i) {
    const Vec3 p = plane.at(random.uniform(0, 2), random.uniform(-1, 1.3));
    EXPECT_TRUE(surface.flat_box().has(p)) << i;
    EXPECT_TRUE(surface.is_in_all_planes(p, 1e-9)) << i;
    EXPECT_FALSE(surface.is_in_all_planes(p + 1e-8 * plane.normal(), 1e-9)) << i;
    for (const SweptTriangle& triangle : surface.triangles())
      EXPECT_LE(std::abs(triangle.signed_distance(p)), 1e-9) << i;
  }
  EXPECT_FALSE(surface.is_in_all_planes(plane.at(9, 0), 1e-9));
  surface.clear();
  EXPECT_EQ(surface.flat(1), nullptr);
}

TEST(SweptSurface, ThatBendsOrHasTwoLayersIsNotFlat) {
  const Slanted plane;
  SweptSurface bent, layers;
  plane.sweep(bent);
  const BladeLine last = plane.line(2), on = plane.line(3);
  bent.add_quad(last, {on.heel + 1e-5 * plane.normal(), on.tip}, 1, 1, 6, false);
  bent.build();
  EXPECT_EQ(bent.flat(1e-6), nullptr);
  EXPECT_FALSE(bent.is_in_all_planes(plane.at(1, 0), 1e-6));
  plane.sweep(layers);
  const Vec3 up = 0.01 * plane.normal();
  layers.add_quad({last.heel + up, last.tip + up}, {on.heel + up, on.tip + up}, 1, 1, 6, false);
  layers.build();
  EXPECT_EQ(layers.flat(1e-6), nullptr);
  EXPECT_FALSE(layers.is_in_all_planes(plane.at(1, 0), 1e-6));
}

}  // namespace
}  // namespace incise::core
