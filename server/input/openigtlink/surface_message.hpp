#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "protocol/framing.hpp"
#include "protocol/surface.hpp"
#include "server/input/placement.hpp"

namespace incise::input::openigtlink {

// The surface in a snapshot's frames (begin, chunks, end). Null, and the reason, if they are not complete.
std::unique_ptr<protocol::SurfaceReplica> surface_of(
    std::span<const std::shared_ptr<const protocol::Frame>> frames, std::string& error);

// A POLYDATA message: the triangles, their vertices in the units and axes of `peers` (the placement of the peers' space
// in the world), and for each vertex the scalars `piece` and `cut` (1 if a triangle at it was made by the blade). O(surface log surface).
std::vector<std::uint8_t> pack_surface(const protocol::SurfaceReplica& surface, const Placement& peers,
                                       const std::string& device);

}  // namespace incise::input::openigtlink
