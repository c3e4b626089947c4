#include "server/core/cut/conforming/cut_faces.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace incise::core {

bool CutFaces::is_within(const Vec3& p, double reach) {
  const auto along = [&](double x) { return static_cast<std::int64_t>(std::floor(x / cut_.h)); };
  const std::array<std::int64_t, 3> at{along(p.x), along(p.y), along(p.z)};
  const std::int64_t hash = at[0] + 7 * at[1] + 49 * at[2];
  Cell& cell = cells_[static_cast<std::size_t>(hash) % kCells];
  if (cell.serial != serial_ || cell.at != at) {
    cell.serial = serial_;
    cell.at = at;
    list(cell);
  }
  cut_.work.add(cell.faces.size(), cost::kWallsAUnit);
  return std::ranges::any_of(cell.faces, [&](const Face& f) {
    return f.around.has(p, reach) && squared_length(closest_point(p, f.a, f.b, f.c) - p) <= reach * reach;
  });
}

void CutFaces::list(Cell& cell) {
  const TetMesh& mesh = cut_.mesh;
  const auto low = [&](std::size_t axis) { return static_cast<double>(cell.at[axis]) * cut_.h; };
  const Vec3 corner{low(0), low(1), low(2)};
  const Box near =
      Box{corner, corner + Vec3{cut_.h, cut_.h, cut_.h}}.widened(1.001 * tolerance::kFilmReach_h * cut_.h);
  cell.faces.clear();
  std::size_t looked_at = 0;
  cut_.workspace.grid.visit_box(near.low, near.high, [&](TetId t) {
    ++looked_at;
    // It is in several of the grid's cells.
    if (std::exchange(lately_[t % kLately], t) == t || !mesh.alive(t)) return;
    for (int f = 0; f < 4; ++f) {
      if (!(mesh.cut_mask(t) >> f & 1)) continue;
      const auto v = mesh.face_vertices(half_face(t, f));
      const Vec3 &a = mesh.position(v[0]), &b = mesh.position(v[1]), &c = mesh.position(v[2]);
      const Box around = Box::around({a, b, c});
      if (around.meets(near)) cell.faces.push_back({around, a, b, c});
    }
  });
  cut_.work.add(looked_at, cost::kGridEntriesAUnit);
  lately_.fill(kNone);
}

}  // namespace incise::core
