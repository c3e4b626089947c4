#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "server/core/cut/held_faces.hpp"
#include "server/core/cut/sweep_ends.hpp"
#include "server/core/cut/swept_memory.hpp"
#include "server/core/mesh/boundary_grid.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/util/archive.hpp"
#include "server/core/util/room.hpp"

namespace incise::core {

struct CutContext;

// Marks for each vertex and each tetrahedron that the blades of one mesh share: sized to the mesh once, then grown
// with it, never cleared. A mark holds when it equals the number of the stroke, the pass or the collection that asks.
struct CutWorkspace {
  struct VertexMarks {
    std::uint32_t surface = 0;  // the stroke on whose swept surface it was put ...
    std::uint32_t batch = 0;    // ... and the stroke's batch that did so
    // The same before that: where two blades meet, it may lie on the surfaces of both.
    std::uint32_t also = 0;
    std::uint32_t also_batch = 0;
    std::uint32_t failed = 0;  // the stroke that could not deal with a crossing at it
    std::uint32_t rim = 0;     // the stroke on whose sweep's rim it was put
    std::uint32_t stands = 0;  // the stroke for whose swept surface it stands where it is, near to that
    std::uint32_t first_crossing = 0;  // of the edges whose lower vertex it is, in Crossings
    std::uint32_t crossings = 0;       // the collection that first_crossing belongs to
    std::uint32_t looked_at = 0;       // the last scan that came by (ActiveSet, ClosingStage)
    std::uint32_t tried = 0;           // the repairs in which moving it, as its star is now, was of no use
    std::uint32_t moves = 0;           // how often a blade has moved it (SeenEdges)
    bool hot = false;                  // in ActiveSet's scan: it is near the blade
    bool listed = false;               // in the list of a blade (PinchedEdges)
  };
  struct TetMarks {
    std::uint32_t pass = 0;    // the last pass that has it (TetPass)
    std::uint32_t active = 0;  // the stroke that has it in its list
    std::uint8_t pending = 0;  // bit f: face f is about to open
    std::uint8_t waiting = 0;  // bit f: face f waits for the blade to go on (ClosingStage), in the stroke
    std::uint32_t waits_for = 0;
  };

  explicit CutWorkspace(const TetMesh& mesh) : CutWorkspace(mesh, BoundaryGrid(mesh)) {}
  // With the grid of a mesh that this one is a copy of.
  CutWorkspace(const TetMesh& mesh, BoundaryGrid its_grid) : grid(std::move(its_grid)) {
    reserve_room(vertices, mesh.vertex_slots());
    reserve_room(tets, mesh.tet_slots());
    grow(mesh);
  }

  // Takes in what has been added to the mesh: a copy of a vertex lies on the surfaces that the vertex lay on.
  void grow(const TetMesh& mesh) {
    for (VertexId v = static_cast<VertexId>(vertices.size()); v < mesh.vertex_slots(); ++v) {
      VertexMarks marks;
      if (mesh.is_new(v) && mesh.provenance(v).a == mesh.provenance(v).b) {
        marks = vertices[mesh.provenance(v).a];
        marks.crossings = marks.looked_at = 0;
        marks.listed = false;
      }
      vertices.push_back(marks);
    }
    tets.resize(mesh.tet_slots());
  }
  std::uint32_t next_serial() { return ++serial; }

  void archive(Archive& io, const TetMesh& mesh) {
    grid.archive(io, mesh);
    ends.archive(io);
    swept.archive(io);
    held.archive(io, mesh);
    ribs.archive(io, mesh);
    necks.archive(io, mesh);
    io.list(vertices, 28, [&](VertexMarks& marks) {
      io(marks.surface);
      io(marks.batch);
      io(marks.also);
      io(marks.also_batch);
      io(marks.failed);
      io(marks.rim);
      io(marks.stands);
    });
    io.list(tets, 4, [&](TetMarks& marks) { io(marks.active); });
    if (!io.reads()) return;
    const auto check = [&](const BladeLine&, const LineAnchor& anchor) {
      io.demand(anchor.is_of(mesh.vertex_slots()), "an anchor at a vertex that does not exist");
    };
    ends.each_line(check);
    swept.each_line(check);
    io.demand(vertices.size() == mesh.vertex_slots() && tets.size() == mesh.tet_slots(),
              "stamps and mesh differ in size");
    if (io.failed()) return;
    grow_to(vertices, mesh.vertex_slots());
    grow_to(tets, mesh.tet_slots());
  }

  BoundaryGrid grid;
  SweepEnds ends;
  SweptMemory swept;
  HeldFaces held;
  HeldFaces ribs;   // between a sweep and the boundary: both sides are on one side of the sweep
  HeldFaces necks;  // the same, or less is known of them: what was swept has to part their sides
  std::vector<VertexMarks> vertices;
  std::vector<TetMarks> tets;
  std::vector<CutContext*> blades;  // all of this mesh
  std::uint32_t serial = 0;         // the last number that was given to a pass, a scan or a collection
};

// A pass over tetrahedra that knows which it has, without clearing marks: each search, scan or verification has its own.
// There is one stamp for each tetrahedron, so a pass forgets those that a later pass has taken: passes take turns.
class TetPass {
 public:
  explicit TetPass(CutWorkspace& workspace) : workspace_(workspace) {}
  // Has none.
  void begin() { serial_ = workspace_.next_serial(); }
  bool has(TetId t) const { return workspace_.tets[t].pass == serial_; }
  void add(TetId t) { workspace_.tets[t].pass = serial_; }
  // Whether t is new to it.
  bool insert(TetId t) {
    if (has(t)) return false;
    add(t);
    return true;
  }
  std::uint32_t serial() const { return serial_; }
  // Both are of the same workspace.
  void swap(TetPass& other) { std::swap(serial_, other.serial_); }

 private:
  CutWorkspace& workspace_;
  std::uint32_t serial_ = 0;
};

}  // namespace incise::core
