#include "server/core/geometry/predicates.hpp"

#include <array>
#include <cmath>

namespace incise::core {
namespace {

// An exact sum of doubles: components that do not overlap, by increasing magnitude (Shewchuk 1997, section 2).
class Expansion {
 public:
  // GROW-EXPANSION with zero elimination (figure 6): adds one double, exactly.
  void add(double value) {
    double q = value;
    std::size_t kept = 0;
    for (std::size_t i = 0; i < size_; ++i) {
      const double sum = q + components_[i];
      const double b_virtual = sum - q;
      const double error = (q - (sum - b_virtual)) + (components_[i] - b_virtual);
      if (error != 0) components_[kept++] = error;
      q = sum;
    }
    if (q != 0) components_[kept++] = q;
    size_ = kept;
  }

  // Adds sign * p * q * r, exactly.
  void add_product(double sign, double p, double q, double r) {
    double pq, pq_tail, high, tail;
    two_product(sign * p, q, pq, pq_tail);
    two_product(pq_tail, r, high, tail);
    add(tail);
    add(high);
    two_product(pq, r, high, tail);
    add(tail);
    add(high);
  }

  int sign() const {
    if (size_ == 0) return 0;
    return components_[size_ - 1] > 0 ? 1 : -1;
  }

 private:
  // SPLIT (figure 12): value = high + low with 26 bits each.
  static void split(double value, double& high, double& low) {
    constexpr double kSplitter = 134217729.0;  // 2^27 + 1
    const double c = kSplitter * value;
    high = c - (c - value);
    low = value - high;
  }

  // TWO-PRODUCT (figure 13): a * b = product + tail.
  static void two_product(double a, double b, double& product, double& tail) {
    product = a * b;
    double a_high, a_low, b_high, b_low;
    split(a, a_high, a_low);
    split(b, b_high, b_low);
    tail = a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low);
  }

  std::array<double, 100> components_;  // 24 products of 4 components each
  std::size_t size_ = 0;
};

// The 4 x 4 determinant | p 1 | over its 24 products, so that no difference has to be rounded.
[[gnu::noinline]] int orient3d_exact(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  Expansion sum;
  const auto add_triple = [&sum](double sign, const Vec3& p, const Vec3& q, const Vec3& r) {
    sum.add_product(sign, p.x, q.y, r.z);
    sum.add_product(-sign, p.x, q.z, r.y);
    sum.add_product(sign, p.y, q.z, r.x);
    sum.add_product(-sign, p.y, q.x, r.z);
    sum.add_product(sign, p.z, q.x, r.y);
    sum.add_product(-sign, p.z, q.y, r.x);
  };
  // (b-a) x (c-a) . (d-a) = [b c d] - [a c d] + [a b d] - [a b c]
  add_triple(1, b, c, d);
  add_triple(-1, a, c, d);
  add_triple(1, a, b, d);
  add_triple(-1, a, b, c);
  return sum.sign();
}

}  // namespace

int orient3d(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  const Vec3 u = b - a, v = c - a, w = d - a;
  const double xy = u.x * v.y, yx = u.y * v.x;
  const double yz = u.y * v.z, zy = u.z * v.y;
  const double zx = u.z * v.x, xz = u.x * v.z;
  const double determinant = (yz - zy) * w.x + (zx - xz) * w.y + (xy - yx) * w.z;
  const double permanent = (std::abs(yz) + std::abs(zy)) * std::abs(w.x) +
                           (std::abs(zx) + std::abs(xz)) * std::abs(w.y) +
                           (std::abs(xy) + std::abs(yx)) * std::abs(w.z);
  constexpr double kEpsilon = 0x1p-53;
  constexpr double kErrorBound = (7.0 + 56.0 * kEpsilon) * kEpsilon;  // Shewchuk 1997, section 4.3, bound A
  if (determinant > kErrorBound * permanent) return 1;
  if (-determinant > kErrorBound * permanent) return -1;
  return orient3d_exact(a, b, c, d);
}

}  // namespace incise::core
