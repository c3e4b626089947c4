#include "server/mesh_io/surface.hpp"

#include <algorithm>
#include <numeric>

#include "server/core/mesh/tet_mesh.hpp"

namespace incise::mesh_io {

using core::kNone;
using core::VertexId;

double signed_volume(const Surface& surface) {
  if (surface.positions.empty()) return 0;
  // Relative to a vertex, so that a body far from the origin loses no digits.
  const core::Vec3 origin = surface.positions.front();
  double six_volumes = 0;
  for (const auto& t : surface.triangles) {
    six_volumes += dot(cross(surface.positions[t[0]] - origin, surface.positions[t[1]] - origin),
                       surface.positions[t[2]] - origin);
  }
  return six_volumes / 6.0;
}

Surface boundary_surface(std::span<const core::Vec3> positions, std::span<const std::array<VertexId, 4>> tets,
                         std::vector<std::uint32_t>* half_faces) {
  struct Face {
    VertexId mid, high;
    std::uint32_t half_face;
  };
  const auto corners = [&tets](std::uint32_t h) {
    const auto& f = core::kFaceVertices[core::face_of(h)];
    const auto& tet = tets[core::tet_of(h)];
    return std::array<VertexId, 3>{tet[f[0]], tet[f[1]], tet[f[2]]};
  };
  const auto sorted = [&corners](std::uint32_t h) {
    auto face = corners(h);
    std::sort(face.begin(), face.end());
    return face;
  };
  const auto count = static_cast<std::uint32_t>(4 * tets.size());
  std::vector<std::uint32_t> begin(positions.size() + 1, 0);
  for (std::uint32_t h = 0; h < count; ++h) ++begin[sorted(h)[0] + 1];
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  std::vector<Face> faces(count);
  std::vector<std::uint32_t> next(begin.begin(), begin.end() - 1);
  for (std::uint32_t h = 0; h < count; ++h) {
    const auto face = sorted(h);
    faces[next[face[0]]++] = {face[1], face[2], h};
  }
  std::vector<std::uint32_t> open;
  for (std::size_t v = 0; v < positions.size(); ++v) {
    const auto first = faces.begin() + begin[v], last = faces.begin() + begin[v + 1];
    const auto same = [](const Face& a, const Face& b) { return a.mid == b.mid && a.high == b.high; };
    std::sort(first, last,
              [](const Face& a, const Face& b) { return a.mid != b.mid ? a.mid < b.mid : a.high < b.high; });
    for (auto it = first; it != last;) {
      auto end = it + 1;
      while (end != last && same(*end, *it)) ++end;
      if (end - it == 1) open.push_back(it->half_face);
      it = end;
    }
  }
  std::sort(open.begin(), open.end());

  Surface surface;
  std::vector<VertexId> renumbered(positions.size(), kNone);
  for (const std::uint32_t h : open) {
    for (const VertexId v : corners(h)) renumbered[v] = 0;
  }
  for (std::size_t v = 0; v < positions.size(); ++v) {
    if (renumbered[v] == kNone) continue;
    renumbered[v] = static_cast<VertexId>(surface.positions.size());
    surface.positions.push_back(positions[v]);
  }
  for (const std::uint32_t h : open) {
    const auto c = corners(h);
    surface.triangles.push_back({renumbered[c[0]], renumbered[c[1]], renumbered[c[2]]});
  }
  if (half_faces) *half_faces = std::move(open);
  return surface;
}

}  // namespace incise::mesh_io
