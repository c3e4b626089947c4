#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "protocol/messages.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/mesh_io/mesh_io.hpp"

namespace incise::app {

// What of a delta says where its vertices and tetrahedra come from, as the wire has it: for protocol::carry(). O(delta).
class DeltaOrigins {
 public:
  explicit DeltaOrigins(const core::Delta& delta);
  // Points into this object and the delta.
  protocol::Delta message() const;

 private:
  std::uint32_t vertex_count_;
  std::vector<std::uint32_t> a_, b_, blend_ids_, blend_vertices_, tet_ids_;
  std::vector<double> t_, blend_weights_;
  std::span<const std::uint32_t> elders_;
};

// The fields of a mesh file, carried along while the mesh is cut. A row for each id of a vertex or tetrahedron, dead ones included.
class CarriedFields {
 public:
  CarriedFields() = default;
  // `mesh` was made of `loaded`, and nothing has changed it yet. O(mesh) where there are fields.
  CarriedFields(const mesh_io::LoadedMesh& loaded, const core::TetMesh& mesh);

  // Each delta, in order. O(delta) for each field.
  void apply(const core::Delta& delta);
  std::span<const mesh_io::Field> all() const { return fields_; }
  // With rows as mesh.export_data() has vertices and tetrahedra. O(mesh).
  std::vector<mesh_io::Field> exported(const core::TetMesh& mesh) const;

 private:
  std::vector<mesh_io::Field> fields_;
};

}  // namespace incise::app
