#pragma once

#include <cstdint>
#include <vector>

#include "server/core/mesh/boundary_grid.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/util/room.hpp"

namespace incise::core {

// Marks for each vertex and each tetrahedron that the blades of one mesh share: sized to the mesh once, then grown
// with it, never cleared. A mark holds when it equals the serial number of the search or the stroke that asks.
struct CutWorkspace {
  struct VertexMarks {
    std::uint32_t surface = 0;      // the stroke on whose swept surface it was put ...
    std::uint32_t batch = 0;        // ... and the stroke's batch that did so
    std::uint32_t failed = 0;       // the stroke that could not deal with a crossing at it
    std::uint32_t rim = 0;          // the stroke on whose sweep's rim it was put
    std::uint32_t event_head = 0;   // the first event of an edge whose lower vertex it is
    std::uint32_t event_stamp = 0;  // the collection that event_head belongs to
    std::uint32_t looked_at = 0;    // the collection that found out whether it is near the blade
    std::uint32_t tried = 0;        // the repairs in which moving it, as its star is now, was of no use
    bool hot = false;               // looked_at: it is near
  };
  struct TetMarks {
    std::uint32_t seen = 0;    // the last search that came by, or verification that found it clear
    std::uint32_t active = 0;  // the stroke that has it in its list
    std::uint8_t pending = 0;  // bit f: face f is about to open
  };

  explicit CutWorkspace(const TetMesh& mesh) : grid(mesh) {
    vertices.reserve(room_for(mesh.vertex_slots()));
    tets.reserve(room_for(mesh.tet_slots()));
    grow(mesh);
  }

  // Takes in what has been added to the mesh: a copy of a vertex lies on the surfaces that the vertex lay on.
  void grow(const TetMesh& mesh) {
    for (VertexId v = static_cast<VertexId>(vertices.size()); v < mesh.vertex_slots(); ++v) {
      VertexMarks marks;
      if (mesh.is_new(v) && mesh.provenance(v).a == mesh.provenance(v).b) {
        marks = vertices[mesh.provenance(v).a];
        marks.event_stamp = marks.looked_at = 0;
      }
      vertices.push_back(marks);
    }
    tets.resize(mesh.tet_slots());
  }

  BoundaryGrid grid;
  std::vector<VertexMarks> vertices;
  std::vector<TetMarks> tets;
  std::uint32_t serial = 0;  // of the last search or collection
};

}  // namespace incise::core
