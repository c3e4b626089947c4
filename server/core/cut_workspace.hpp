#pragma once

#include <cstdint>
#include <vector>

#include "server/core/boundary_grid.hpp"
#include "server/core/room.hpp"
#include "server/core/tet_mesh.hpp"

namespace incise::core {

// Marks for each vertex and each tetrahedron that the blades of one mesh share: sized to the mesh once, then grown
// with it, never cleared. A mark holds when it equals the serial number of the search or the stroke that asks.
struct CutWorkspace {
  explicit CutWorkspace(const TetMesh& mesh) : grid(mesh) {
    const std::size_t vertices = mesh.vertex_slots(), tets = mesh.tet_slots();
    surface.reserve(room_for(vertices));
    failed.reserve(surface.capacity());
    rim.reserve(surface.capacity());
    event_head.reserve(surface.capacity());
    event_stamp.reserve(surface.capacity());
    seen.reserve(room_for(tets));
    active.reserve(seen.capacity());
    pending.reserve(seen.capacity());
    grow(mesh);
  }

  // Takes in what has been added to the mesh: a copy of a vertex lies on the surfaces that the vertex lay on.
  void grow(const TetMesh& mesh) {
    for (VertexId v = static_cast<VertexId>(surface.size()); v < mesh.vertex_slots(); ++v) {
      const VertexId original =
          mesh.is_new(v) && mesh.provenance(v).a == mesh.provenance(v).b ? mesh.provenance(v).a : kNone;
      surface.push_back(original == kNone ? 0 : surface[original]);
      failed.push_back(original == kNone ? 0 : failed[original]);
      rim.push_back(original == kNone ? 0 : rim[original]);
      event_head.push_back(0);
      event_stamp.push_back(0);
    }
    seen.resize(mesh.tet_slots(), 0);
    active.resize(mesh.tet_slots(), 0);
    pending.resize(mesh.tet_slots(), 0);
  }

  BoundaryGrid grid;
  std::vector<std::uint32_t> surface;      // by vertex: the stroke on whose swept surface it was put
  std::vector<std::uint32_t> failed;       // by vertex: the stroke that could not deal with a crossing at it
  std::vector<std::uint32_t> rim;          // by vertex: the stroke on whose sweep's rim it was put
  std::vector<std::uint32_t> event_head;   // by vertex: the first event of an edge whose lower vertex it is
  std::vector<std::uint32_t> event_stamp;  // by vertex: the collection that event_head belongs to
  std::vector<std::uint32_t> seen;         // by tetrahedron: the last search that came by
  std::vector<std::uint32_t> active;       // by tetrahedron: the stroke that has it in its list
  std::vector<std::uint8_t> pending;       // by tetrahedron: bit f: face f is about to open
  std::uint32_t serial = 0;                // of the last search or collection
};

}  // namespace incise::core
