#include "tests/oracle/fewest_faces.hpp"

namespace incise::oracle {

using core::HalfFace;
using core::kNone;
using core::TetId;

std::vector<HalfFace> fewest_faces_between(const core::TetMesh& mesh, std::span<const End> ends,
                                           std::size_t most) {
  // By half-face: what flows through it, out of its tetrahedron.
  std::vector<std::int8_t> flow(4 * mesh.tet_slots(), 0);
  std::vector<HalfFace> through(
      mesh.tet_slots());  // how a tetrahedron was reached: a half-face of the one before it
  std::vector<std::uint8_t> reached(mesh.tet_slots());
  std::vector<TetId> queue;
  const auto reach_other_end = [&] {
    reached.assign(mesh.tet_slots(), 0);
    queue.clear();
    for (TetId t = 0; t < mesh.tet_slots(); ++t) {
      if (!mesh.alive(t) || ends[t] != End::kOne) continue;
      reached[t] = 1;
      queue.push_back(t);
    }
    for (std::size_t i = 0; i < queue.size(); ++i) {
      for (int f = 0; f < 4; ++f) {
        const HalfFace h = core::half_face(queue[i], f), o = mesh.opposite(h);
        if (o == kNone || flow[h] > 0 || reached[core::tet_of(o)] != 0) continue;
        const TetId n = core::tet_of(o);
        reached[n] = 1;
        through[n] = h;
        if (ends[n] == End::kOther) return n;
        queue.push_back(n);
      }
    }
    return kNone;
  };
  std::vector<HalfFace> faces;
  for (std::size_t ways = 0;; ++ways) {
    TetId t = reach_other_end();
    if (t == kNone) break;
    if (ways == most) return faces;
    for (; ends[t] != End::kOne; t = core::tet_of(through[t])) {
      ++flow[through[t]];
      --flow[mesh.opposite(through[t])];
    }
  }
  for (TetId t : queue) {
    for (int f = 0; f < 4; ++f) {
      const HalfFace h = core::half_face(t, f), o = mesh.opposite(h);
      if (o != kNone && reached[core::tet_of(o)] == 0) faces.push_back(h);
    }
  }
  return faces;
}

}  // namespace incise::oracle
