#pragma once

#include <memory>
#include <span>

#include "server/core/mesh/mesh_data.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/haptics/cut_map.hpp"
#include "server/haptics/rest_map.hpp"
#include "server/haptics/surface_tree.hpp"

namespace incise::haptics {

// What forces need to know of a body: how it was loaded, and where it has been cut since. Cutting takes nothing away and
// bends nothing (but flat tetrahedra, and vertices that slide within their surface by hundredths of h), so which part of a
// blade is inside does not depend on the cuts: it is found in the body as loaded, at a cost that no cut changes. A
// separate map says where the body is cut. In a body that deforms, the edge is first taken back to the body at rest.
//
// Thread: one, at a time. Owns 140 bytes a boundary triangle, and the map; shares the mesh.
class Tissue {
 public:
  explicit Tissue(const core::MeshData& loaded) : Tissue(std::make_shared<const core::TetMesh>(loaded)) {}
  // Of a mesh that others use, too: it is not asked for what uses scratch memory.
  explicit Tissue(std::shared_ptr<const core::TetMesh> loaded);

  const core::TetMesh& body() const { return *body_; }
  const SurfaceTree& surface() const { return surface_; }
  const CutMap& cuts() const { return cuts_; }
  const RestMap& rest() const { return rest_; }
  double h() const { return body_->mean_edge_length(); }

  // The mesh that is cut, for where it is now; it must outlive this or the next call. Without: the body stays as loaded.
  void follow(const core::TetMesh& now) { rest_.follow(now); }

  // Takes note of those of the faces that are cut faces of the mesh as it is now; O(faces).
  void note_cuts(const core::TetMesh& now, std::span<const core::HalfFace> faces) noexcept;
  // Of all there are; O(mesh).
  void note_cuts(const core::TetMesh& now) noexcept;
  // It is whole again.
  void heal() noexcept { cuts_.clear(); }

 private:
  const std::shared_ptr<const core::TetMesh> body_;
  const SurfaceTree surface_;
  CutMap cuts_;  // at rest
  RestMap rest_;
};

}  // namespace incise::haptics
