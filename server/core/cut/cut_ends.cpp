#include "server/core/cut/cut_ends.hpp"

#include <algorithm>
#include <tuple>
#include <vector>

namespace incise::core {

void remember_cut_ends(const TetMesh& mesh, SweptMemory& swept) {
  // An edge of a cut's face, its lower end first, and the vertex across.
  struct Edge {
    VertexId a, b, across;
  };
  std::vector<Edge> edges;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    for (int f = 0; f < 4; ++f) {
      if (!(mesh.cut_mask(t) >> f & 1)) continue;
      const auto v = mesh.face_vertices(half_face(t, f));
      for (std::size_t k = 0; k < 3; ++k) {
        const auto [a, b] = std::minmax(v[k], v[(k + 1) % 3]);
        edges.push_back({a, b, v[(k + 2) % 3]});
      }
    }
  }
  const auto key = [](const Edge& e) { return std::tie(e.a, e.b, e.across); };
  std::ranges::sort(edges, {}, key);
  for (std::size_t i = 0, end; i < edges.size(); i = end) {
    for (end = i + 1; end < edges.size() && edges[end].a == edges[i].a && edges[end].b == edges[i].b;) ++end;
    if (end - i != 2) continue;
    // Both sides of the cut have it: the tissue hangs together there.
    const Vec3 &across = mesh.position(edges[i].across), &other = mesh.position(edges[i + 1].across);
    if (across != other) continue;
    swept.add({{across, mesh.position(edges[i].a)},
               {across, mesh.position(edges[i].b)},
               0,
               0,
               true,
               0,
               {{{}, {1, 1}}}});
  }
}

}  // namespace incise::core
