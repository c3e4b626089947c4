#pragma once

#include <memory>
#include <string>
#include <vector>

#include "protocol/surface_asset.hpp"
#include "server/mesh_io/surface.hpp"
#include "server/stream/providers.hpp"

namespace incise::app {

// The surface that a body was filled from, in the protocol's terms. Its arrays are those of `surface`; images are named by the index of the
// first material that has them: "0.png".
protocol::SurfaceAsset asset_of(const mesh_io::Surface& surface);
// Finds the origins of boundary faces. Null without a surface. O(n log n).
std::shared_ptr<const protocol::OriginTree> origin_tree(const mesh_io::Surface* surface);

// What the HTTP port serves of it: the asset, and the images that its materials name. They are in memory, so a request names no file. Nothing, and
// a line in `warnings`, where the asset is too long for a message.
struct ServedSurface {
  std::optional<protocol::SurfaceFacts> facts;
  stream::Documents documents;
};
ServedSurface served_surface(const mesh_io::Surface* surface, std::vector<std::string>& warnings);

}  // namespace incise::app
