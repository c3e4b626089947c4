#pragma once

#include <vector>

#include "protocol/surface_asset.hpp"
#include "server/app/offline/cut_surface.hpp"

namespace incise::app {

// Splits the triangles that reach over a seam of the texture along it, so that each part has its origin, and with it its texture coordinates, on its own
// side; without this a corner beyond the seam takes them from outside of the chart. Neighbours get the new vertices of their edges, so the surface stays
// closed. `rest`: where each vertex of out.surface is in the body at rest; `faces`: of each triangle; both follow. out.surface has no look yet, and
// out.origins are known. O(triangles).
void split_at_seams(const protocol::SurfaceLookup& lookup, const protocol::OriginTree& tree,
                    std::vector<core::Vec3>& rest, std::vector<core::HalfFace>& faces, CutSurface& out);

}  // namespace incise::app
