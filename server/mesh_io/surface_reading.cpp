#include "server/mesh_io/surface_reading.hpp"

#include <algorithm>
#include <numeric>
#include <tuple>

#include "server/mesh_io/mesh_error.hpp"

namespace incise::mesh_io {

using core::Vec3;
using core::VertexId;

namespace {

// Merges vertices at exactly the same place into the first of them, and drops unused ones.
void weld(Surface& surface) {
  const auto& p = surface.positions;
  std::vector<VertexId> order(p.size()), canonical(p.size());
  std::iota(order.begin(), order.end(), VertexId{0});
  std::sort(order.begin(), order.end(), [&p](VertexId a, VertexId b) {
    return std::tie(p[a].x, p[a].y, p[a].z, a) < std::tie(p[b].x, p[b].y, p[b].z, b);
  });
  for (std::size_t i = 0; i < order.size(); ++i) {
    canonical[order[i]] = i > 0 && p[order[i]] == p[order[i - 1]] ? canonical[order[i - 1]] : order[i];
  }
  std::vector<VertexId> renumbered(p.size(), core::kNone);
  for (const auto& triangle : surface.triangles) {
    for (const VertexId v : triangle) renumbered[canonical[v]] = 0;
  }
  std::vector<Vec3> kept;
  for (std::size_t v = 0; v < p.size(); ++v) {
    if (renumbered[v] == core::kNone) continue;
    renumbered[v] = static_cast<VertexId>(kept.size());
    kept.push_back(p[v]);
  }
  for (auto& triangle : surface.triangles) {
    for (VertexId& v : triangle) v = renumbered[canonical[v]];
  }
  surface.positions = std::move(kept);
}

}  // namespace

void add_polygon(Surface& surface, const std::vector<VertexId>& corners) {
  for (std::size_t i = 2; i < corners.size(); ++i) {
    surface.triangles.push_back({corners[0], corners[i - 1], corners[i]});
  }
}

Surface finish(Surface surface, const std::filesystem::path& path) {
  if (surface.triangles.empty()) throw MeshError(path.string() + ": there is no triangle");
  weld(surface);
  return surface;
}

bool equals_ignoring_case(std::string_view field, std::string_view lowercase) {
  return std::equal(field.begin(), field.end(), lowercase.begin(), lowercase.end(),
                    [](char a, char b) { return (a >= 'A' && a <= 'Z' ? a + 32 : a) == b; });
}

Vec3 read_point(const LineReader& in, std::size_t first) {
  return {in.number(first, "the coordinate x"), in.number(first + 1, "the coordinate y"),
          in.number(first + 2, "the coordinate z")};
}

}  // namespace incise::mesh_io
