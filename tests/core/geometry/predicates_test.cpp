#include "server/core/geometry/predicates.hpp"

#include <gtest/gtest.h>

#include <boost/multiprecision/cpp_int.hpp>
#include <cmath>

#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using boost::multiprecision::cpp_int;
using testing::Random;

// The reference: doubles are integers times powers of two; scaled by one common power, the determinant is a
// determinant of integers.
int exact_orient3d(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  const double in[12] = {a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z, d.x, d.y, d.z};
  int lowest = 0;
  bool any = false;
  for (double value : in) {
    int exponent = 0;
    if (value == 0) continue;
    std::frexp(value, &exponent);
    lowest = any ? std::min(lowest, exponent - 53) : exponent - 53;
    any = true;
  }
  cpp_int out[12];
  for (int i = 0; i < 12; ++i) {
    int exponent = 0;
    const double mantissa = std::frexp(in[i], &exponent);
    if (in[i] == 0) continue;
    out[i] = static_cast<std::int64_t>(std::ldexp(mantissa, 53));
    out[i] <<= exponent - 53 - lowest;
  }
  const auto difference = [&](int point, int axis) -> cpp_int { return out[3 * point + axis] - out[axis]; };
  const cpp_int ux = difference(1, 0), uy = difference(1, 1), uz = difference(1, 2);
  const cpp_int vx = difference(2, 0), vy = difference(2, 1), vz = difference(2, 2);
  const cpp_int wx = difference(3, 0), wy = difference(3, 1), wz = difference(3, 2);
  const cpp_int det = (uy * vz - uz * vy) * wx + (uz * vx - ux * vz) * wy + (ux * vy - uy * vx) * wz;
  return det.sign();
}

// Compares with the reference, and over all orders of the four points, by whose parity the sign turns.
void expect_exact(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  const int expected = exact_orient3d(a, b, c, d);
  ASSERT_EQ(orient3d(a, b, c, d), expected)
      << std::hexfloat << a.x << ' ' << a.y << ' ' << a.z << ", " << b.x << ' ' << b.y << ' ' << b.z << ", "
      << c.x << ' ' << c.y << ' ' << c.z << ", " << d.x << ' ' << d.y << ' ' << d.z;
  ASSERT_EQ(orient3d(b, a, c, d), -expected);
  ASSERT_EQ(orient3d(b, c, a, d), expected);
  ASSERT_EQ(orient3d(a, b, d, c), -expected);
  ASSERT_EQ(orient3d(d, c, b, a), expected);
}

TEST(Orient3d, ByHand) {
  EXPECT_EQ(orient3d({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}), 1);
  EXPECT_EQ(orient3d({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, -1}), -1);
  EXPECT_EQ(orient3d({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {5, 7, 0}), 0);
  EXPECT_EQ(orient3d({0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {5, 7, 0x1p-200}), 1);
  EXPECT_EQ(orient3d({1, 1, 1}, {1, 1, 1}, {1, 1, 1}, {1, 1, 1}), 0);
  EXPECT_EQ(orient3d({0.1, 0.1, 0.1}, {0.2, 0.2, 0.2}, {0.3, 0.3, 0.3}, {9, 4, 2}),
            exact_orient3d({0.1, 0.1, 0.1}, {0.2, 0.2, 0.2}, {0.3, 0.3, 0.3}, {9, 4, 2}))
      << "0.1, 0.2 and 0.3 are not on a line in double precision";
}

TEST(Orient3d, RandomPoints) {
  Random random(1);
  for (int i = 0; i < 60000 && !HasFatalFailure(); ++i) {
    const auto p = [&] { return random.in_box({-1, -1, -1}, {1, 1, 1}); };
    const Vec3 a = p(), b = p(), c = p(), d = p();
    expect_exact(a, b, c, d);
  }
}

// The fourth point in the plane of the others but for its rounding, and a few units in the last place around
// that.
TEST(Orient3d, NearlyCoplanarPoints) {
  Random random(2);
  int zero = 0, positive = 0, negative = 0;
  for (int i = 0; i < 60000 && !HasFatalFailure(); ++i) {
    const double size = std::pow(10, random.uniform(-3, 3));
    const Vec3 offset = i % 2 == 0 ? Vec3{} : random.in_box({-100, -100, -100}, {100, 100, 100});
    const auto p = [&] { return offset + size * random.in_box({-1, -1, -1}, {1, 1, 1}); };
    const Vec3 a = p(), b = p(), c = p();
    Vec3 d = a + random.uniform(-2, 2) * (b - a) + random.uniform(-2, 2) * (c - a);
    for (std::uint32_t step = random.below(3); step > 0; --step) d.z = std::nextafter(d.z, 1e9);
    expect_exact(a, b, c, d);
    const int sign = orient3d(a, b, c, d);
    (sign == 0 ? zero : sign > 0 ? positive : negative) += 1;
  }
  EXPECT_GT(positive, 1000);
  EXPECT_GT(negative, 1000);
}

// Small integers: most are exactly in a plane, on a line, or one point.
TEST(Orient3d, IntegerGrid) {
  Random random(3);
  int zero = 0;
  for (int i = 0; i < 60000 && !HasFatalFailure(); ++i) {
    const std::uint32_t n = 2 + random.below(4);
    const auto p = [&] {
      return Vec3{double(random.below(n)), double(random.below(n)), double(random.below(n))};
    };
    const Vec3 a = p(), b = p(), c = p(), d = p();
    expect_exact(a, b, c, d);
    zero += orient3d(a, b, c, d) == 0 ? 1 : 0;
  }
  EXPECT_GT(zero, 10000);
}

// A grid of neighbouring doubles around a point of the plane through three others, the classic of Kettner et
// al. (2008, "Classroom examples of robustness problems in geometric computations"), in three dimensions.
TEST(Orient3d, NeighbouringDoubles) {
  const double ulp = 0x1p-53;
  const Vec3 b{12, 12, 12}, c{24, 24, 24.5}, d{7, 31, 2};
  for (int i = 0; i < 48; ++i) {
    for (int j = 0; j < 48; ++j) {
      for (int k = 0; k < 4 && !HasFatalFailure(); ++k) {
        expect_exact({0.5 + i * ulp, 0.5 + j * ulp, 0.5 + k * ulp}, b, c, d);
        expect_exact({0.5 + i * ulp, 0.5 + j * ulp, 0.5 + k * ulp}, b, {24, 24, 24}, d);
        expect_exact({0.5 + i * ulp, 0.5 + j * ulp, 0.5}, {12, 12, 0.5}, {24, 24 + k * ulp, 0.5},
                     {3, 4, 0.5});
      }
    }
  }
}

// Coordinates of very different magnitude, up to what the header promises.
TEST(Orient3d, WideExponents) {
  Random random(4);
  for (int i = 0; i < 30000 && !HasFatalFailure(); ++i) {
    const auto coordinate = [&]() -> double {
      if (random.below(8) == 0) return 0;
      const double sign = random.below(2) == 0 ? -1 : 1;
      return sign * std::ldexp(random.uniform(0.5, 1), static_cast<int>(random.below(530)) - 265);
    };
    const auto p = [&] { return Vec3{coordinate(), coordinate(), coordinate()}; };
    const Vec3 a = p(), b = p(), c = p();
    Vec3 d = random.below(2) == 0 ? p() : a;
    if (d == a) d.x += b.x;
    expect_exact(a, b, c, d);
  }
}

// The same tiny, nearly flat tetrahedra at both ends of the range of magnitudes.
TEST(Orient3d, ScaledToTheLimits) {
  Random random(5);
  for (double scale : {0x1p-265, 0x1p-100, 0x1p100, 0x1p295}) {
    for (int i = 0; i < 10000 && !HasFatalFailure(); ++i) {
      const auto p = [&] {
        return scale * random.in_box({1, 1, 1}, {1 + 0x1p-40, 1 + 0x1p-40, 1 + 0x1p-40});
      };
      const Vec3 a = p(), b = p(), c = p();
      expect_exact(a, b, c, i % 2 == 0 ? p() : a + 0.5 * (b - a) + 0.25 * (c - a));
    }
  }
}

}  // namespace
}  // namespace incise::core
