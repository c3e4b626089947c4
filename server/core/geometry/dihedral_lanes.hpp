#pragma once

#include <algorithm>

#include "server/core/geometry/quality.hpp"

namespace incise::core {

// Vectors are passed between functions that are always inlined, so that no calling convention matters.
#pragma GCC diagnostic ignored "-Wpsabi"

// worst_dihedral() of four tetrahedra at once. The same operations on each lane as for one, so the same bits, whatever
// the width of the machine's registers.
struct DihedralLanes {
  using V = double __attribute__((vector_size(32)));
  struct V3 {
    V x, y, z;
  };

  [[gnu::always_inline]] static inline V3 minus(const V3& a, const V3& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
  }
  [[gnu::always_inline]] static inline V3 times(const V3& a, const V3& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
  }
  [[gnu::always_inline]] static inline V dot(const V3& a, const V3& b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
  }
  [[gnu::always_inline]] static inline V larger(const V& a, const V& b) { return a < b ? b : a; }
  [[gnu::always_inline]] static inline double largest(const V& v) {
    return std::max(std::max(v[0], v[1]), std::max(v[2], v[3]));
  }
  [[gnu::always_inline]] static inline V measure(const V& cosine, const V& qm, const V& qn) {
    return cosine * larger(cosine, -cosine) / (qm * qn);
  }
  // Of tetrahedra whose other vertices are u, v and w beside the first.
  [[gnu::always_inline]] static inline V worst(const V3& u, const V3& v, const V3& w) {
    const V3 nd = times(v, u), nc = times(u, w), nb = times(w, v);
    const V3 minus_na{nd.x + nc.x + nb.x, nd.y + nc.y + nb.y, nd.z + nc.z + nb.z};
    const V qa = dot(minus_na, minus_na), qb = dot(nb, nb), qc = dot(nc, nc), qd = dot(nd, nd);
    V m = larger(measure(dot(minus_na, nb), qa, qb), measure(dot(minus_na, nc), qa, qc));
    m = larger(m, measure(dot(minus_na, nd), qa, qd));
    m = larger(m, measure(-dot(nb, nc), qb, qc));
    m = larger(m, measure(-dot(nb, nd), qb, qd));
    m = larger(m, measure(-dot(nc, nd), qc, qd));
    const V inverted = V{} + kInverted;
    m = qa * qb * qc * qd > 0 ? m : inverted;
    return dot(nd, w) >= 0 ? inverted : m;
  }
};

}  // namespace incise::core
