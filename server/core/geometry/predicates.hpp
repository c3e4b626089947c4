#pragma once

#include "server/core/geometry/vec3.hpp"

namespace incise::core {

// The sign of (b-a) x (c-a) . (d-a): +1 where d lies on the side of the plane a, b, c from which they appear
// counter-clockwise, -1 on the other, 0 exactly in the plane. Exact for finite coordinates whose products neither
// overflow nor underflow (magnitudes between 1e-79 and 1e+89, or zero).
//
// A floating-point evaluation with a forward error bound decides almost always (Shewchuk 1997, "Adaptive Precision
// Floating-Point Arithmetic and Fast Robust Geometric Predicates", section 4.3); else the determinant is summed
// exactly as an expansion (same paper, theorem 10). Some 10 ns, and some microseconds.
int orient3d(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d);

}  // namespace incise::core
