#pragma once

#include <cstdint>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"

namespace incise::core {

// Where a host simulation says that vertices are. Not trusted: CutSession::deform() takes what is valid.
struct VertexPositions {
  std::uint64_t frame = 0;      // the simulation's own number for it
  std::uint64_t revision = 0;   // of the mesh that it computed with
  std::int64_t source_ns = 0;   // its clock
  std::int64_t arrival_ns = 0;  // at this machine; the core does not look at it
  std::vector<VertexId> ids;    // ascending; empty: first, first + 1, ...
  VertexId first = 0;
  std::vector<Vec3> positions;  // metres, world frame
  bool single = false;          // they came as floats, and can be stored so

  VertexId id(std::size_t i) const { return ids.empty() ? first + static_cast<VertexId>(i) : ids[i]; }
};

}  // namespace incise::core
