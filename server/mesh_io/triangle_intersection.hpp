#pragma once

#include <array>
#include <cstddef>
#include <utility>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"
#include "server/mesh_io/surface.hpp"

namespace incise::mesh_io {

// The sign of the area of the triangle a, b, c seen along axis `drop` (0: x, 1: y, 2: z) onto the other two;
// exact.
int orient2d(const core::Vec3& a, const core::Vec3& b, const core::Vec3& c, int drop);

// Whether the three points lie on one line; exact.
bool is_collinear(const core::Vec3& a, const core::Vec3& b, const core::Vec3& c);

// Whether two triangles of a surface meet anywhere but in vertices and edges that they share by index:
// whether they cross, touch or overlap. Exact, whatever the position; neither may be degenerate.
bool triangles_meet(const std::vector<core::Vec3>& positions, const std::array<core::VertexId, 3>& s,
                    const std::array<core::VertexId, 3>& t);

// All such pairs of triangles, each (lower, higher), ascending; the search ends after `limit` of
// them. A tree of boxes: O(n log n) for the surfaces of bodies.
std::vector<std::pair<std::size_t, std::size_t>> self_intersections(const Surface& surface,
                                                                    std::size_t limit);

}  // namespace incise::mesh_io
