#pragma once

#include <cstring>
#include <filesystem>
#include <string_view>
#include <vector>

#include "server/mesh_io/surface_files.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::mesh_io {

// What the readers of surfaces share.

inline constexpr std::size_t kMaxSurfaceVertices = std::size_t{1} << 30;
// A polygon with more corners than this is a mistake, not a face.
inline constexpr std::size_t kMaxPolygonCorners = 10'000;

// What a client accepts (protocol/limits.hpp).
inline constexpr std::size_t kMaxMaterials = 4096;

// Adds a polygon as a fan around its first corner. That is right for convex polygons; later checks find the others.
void add_polygon(Surface& surface, const std::vector<core::VertexId>& corners);

// The surface as read: welds vertices at exactly the same place and drops unused ones. Throws MeshError if there is no
// triangle.
Surface finish(Surface surface, const std::filesystem::path& path);

bool equals_ignoring_case(std::string_view field, std::string_view lowercase);

// The point in three fields of the present line.
core::Vec3 read_point(const LineReader& in, std::size_t first);

// The number in these bytes, in this machine's byte order.
template <class T>
T load(const char* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return value;
}

}  // namespace incise::mesh_io
