#pragma once

#include <span>
#include <vector>

#include "server/core/mesh/field.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// Fields with a row for each id, with rows as mesh.export_data() has vertices and tetrahedra. O(mesh) where there are fields.
std::vector<Field> exported_rows(std::span<const Field> fields, const TetMesh& mesh);

// The fields of a body, carried along while it is cut. A row for each id of a vertex or tetrahedron, dead ones included.
class CarriedFields {
 public:
  CarriedFields() = default;
  // `mesh` was made of `loaded`, whose fields these are, and nothing has changed it yet. O(mesh) where there are fields.
  // Throws MeshError where one has not a row for each vertex or tetrahedron, or a name or number of components beyond field.hpp's limits.
  CarriedFields(std::span<const Field> fields, const MeshData& loaded, const TetMesh& mesh);

  // Each delta, in order. O(delta) for each field.
  void apply(const Delta& delta);
  const std::vector<Field>& all() const { return fields_; }
  // As exported_rows().
  std::vector<Field> exported(const TetMesh& mesh) const { return exported_rows(fields_, mesh); }

  // `mesh`: in whose state they are.
  void archive(Archive& io, const TetMesh& mesh);

 private:
  std::vector<Field> fields_;
};

}  // namespace incise::core
