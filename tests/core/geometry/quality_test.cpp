#include "server/core/geometry/quality.hpp"

#include <gtest/gtest.h>

#include <numbers>

#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using testing::Random;

constexpr double kDegrees = 180.0 / std::numbers::pi;

// The dihedral angle at edge (p, q) between the faces with r and s: that between the parts of r - p and s - p
// square to the edge.
double dihedral_at(const Vec3& p, const Vec3& q, const Vec3& r, const Vec3& s) {
  const Vec3 e = normalized(q - p);
  const Vec3 u = (r - p) - dot(r - p, e) * e, v = (s - p) - dot(s - p, e) * e;
  return std::atan2(length(cross(u, v)), dot(u, v)) * kDegrees;
}

double smallest_dihedral(const std::array<Vec3, 4>& t) {
  double least = 180;
  for (const auto& e : kEdgeVertices) {
    int off[2], n = 0;
    for (int i = 0; i < 4; ++i) {
      if (i != e[0] && i != e[1]) off[n++] = i;
    }
    least = std::min(least, dihedral_at(t[e[0]], t[e[1]], t[off[0]], t[off[1]]));
  }
  return least;
}

double measured(const std::array<Vec3, 4>& t) {
  return measure_to_degrees(worst_dihedral(t[0], t[1], t[2], t[3]));
}

TEST(Quality, KnownTetrahedra) {
  // Regular: arccos(1/3).
  EXPECT_NEAR(measured({{{1, 1, 1}, {1, -1, -1}, {-1, -1, 1}, {-1, 1, -1}}}), 70.528779, 1e-6);
  // The corner of a cube: arccos(1/sqrt 3).
  EXPECT_NEAR(measured({{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}), 54.735610, 1e-6);
}

TEST(Quality, AgreesWithTheAngleAtEachEdge) {
  Random random(1);
  int obtuse = 0;
  for (int i = 0; i < 100000; ++i) {
    const double size = std::pow(10, random.uniform(-5, 3)), flat = std::pow(10, random.uniform(-3, 0));
    std::array<Vec3, 4> t;
    for (Vec3& p : t) {
      p = size * random.in_box({-1, -1, -1}, {1, 1, 1});
      p.z *= flat;
    }
    if (signed_volume(t[0], t[1], t[2], t[3]) < 0) std::swap(t[0], t[1]);
    const double expected = smallest_dihedral(t);
    // Near 0 the cosine is blunt: an error of 1e-16 in it is 1e-6 degrees at 0.01 degrees.
    ASSERT_NEAR(measured(t), expected, 1e-6 + 1e-7 / expected) << "tetrahedron " << i;
    obtuse += expected > 60 ? 1 : 0;
  }
  EXPECT_GT(obtuse, 10);
}

TEST(Quality, TheSameForAllPositiveOrders) {
  Random random(2);
  constexpr int kEven[12][4] = {{0, 1, 2, 3}, {0, 2, 3, 1}, {0, 3, 1, 2}, {1, 0, 3, 2},
                                {1, 2, 0, 3}, {1, 3, 2, 0}, {2, 0, 1, 3}, {2, 1, 3, 0},
                                {2, 3, 0, 1}, {3, 0, 2, 1}, {3, 1, 0, 2}, {3, 2, 1, 0}};
  for (int i = 0; i < 1000; ++i) {
    std::array<Vec3, 4> t;
    for (Vec3& p : t) p = random.in_box({-1, -1, -1}, {1, 1, 1});
    if (signed_volume(t[0], t[1], t[2], t[3]) < 0) std::swap(t[0], t[1]);
    for (const auto& o : kEven) {
      ASSERT_NEAR(worst_dihedral(t[o[0]], t[o[1]], t[o[2]], t[o[3]]), worst_dihedral(t[0], t[1], t[2], t[3]),
                  1e-9);
      ASSERT_EQ(worst_dihedral(t[o[1]], t[o[0]], t[o[2]], t[o[3]]), kInverted);
    }
  }
}

TEST(Quality, FlatAndInvertedAreWorseThanAnything) {
  const Vec3 o{0, 0, 0}, x{1, 0, 0}, y{0, 1, 0};
  EXPECT_EQ(worst_dihedral(o, x, y, {0.3, 0.3, 0}), kInverted);
  EXPECT_EQ(worst_dihedral(o, x, y, {0.3, 0.3, -1}), kInverted);
  EXPECT_EQ(worst_dihedral(o, x, {2, 0, 0}, {0.3, 0.3, 1}), kInverted) << "a face without area";
  EXPECT_EQ(worst_dihedral(o, o, o, o), kInverted);
  EXPECT_EQ(measure_to_degrees(kInverted), 0);
  EXPECT_LE(worst_dihedral(o, x, y, {0.3, 0.3, 1e-6}), kInverted);
}

TEST(Quality, MeasureIsMonotoneInTheAngle) {
  double last = kInverted;
  for (double degrees = 0.25; degrees < 180; degrees += 0.25) {
    const double measure = dihedral_measure(std::cos(degrees / kDegrees));
    EXPECT_LT(measure, last);
    EXPECT_NEAR(measure_to_degrees(measure), degrees, 1e-6);
    last = measure;
  }
}

TEST(Quality, SignedVolume) {
  EXPECT_DOUBLE_EQ(signed_volume({0, 0, 0}, {2, 0, 0}, {0, 3, 0}, {7, 8, 5}), 5);
  EXPECT_DOUBLE_EQ(signed_volume({0, 0, 0}, {0, 3, 0}, {2, 0, 0}, {7, 8, 5}), -5);
}

}  // namespace
}  // namespace incise::core
