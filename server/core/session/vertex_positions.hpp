#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"

namespace incise::core {

// A vertex that a step did not take all the way, since a tetrahedron would have inverted: half the way, or it stays. kNone, behind all others: what clings to
// blades did not go along with the body for that reason.
struct GaveWay {
  VertexId vertex = kNone;
  bool stays = false;

  friend bool operator==(const GaveWay&, const GaveWay&) = default;
};

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
  // What the first session that took them found out, for another one in the same state. Whoever wants that puts a list here; it is
  // filled when the step is done, and may be looked at by those who hear of that.
  std::shared_ptr<std::vector<GaveWay>> outcome;

  VertexId id(std::size_t i) const { return ids.empty() ? first + static_cast<VertexId>(i) : ids[i]; }
};

}  // namespace incise::core
