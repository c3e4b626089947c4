#pragma once

#include <optional>
#include <span>
#include <vector>

#include "server/core/cut/cut_memory.hpp"
#include "server/core/mesh/boundary_grid.hpp"
#include "server/core/mesh/field.hpp"
#include "server/core/mesh/mesh_data.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/carried_fields.hpp"
#include "server/core/session/tet_clusters.hpp"

namespace incise::core {

// What each session of a body begins with: found out once, then copied, which takes a fraction of the time. A session that is made of this is
// the same to the bit as one that is made of the MeshData. It has nothing that only a cut needs.
//
// Thread: any, at the same time: nothing changes it. Its mesh must not be asked for stars, rings or edges, which use scratch memory.
class LoadedBody {
 public:
  // O(mesh). Throws MeshError as CutSession does.
  explicit LoadedBody(const MeshData& data, std::span<const Field> fields = {})
      : LoadedBody(data, fields, ClustersLater{}) {
    form_clusters();
  }
  // The same in two halves that take about as long: form_clusters() once, before the first copy. Meanwhile the mesh can be used.
  struct ClustersLater {};
  LoadedBody(const MeshData& data, std::span<const Field> fields, ClustersLater)
      : mesh_(data), grid_(mesh_), fields_(fields, data, mesh_) {
    if (has_its_cut_memory(data)) cut_memory_ = data.cut_memory;
  }
  void form_clusters() { clusters_.emplace(mesh_); }
  LoadedBody(const LoadedBody&) = delete;
  LoadedBody& operator=(const LoadedBody&) = delete;

  const TetMesh& mesh() const { return mesh_; }
  const BoundaryGrid& grid() const { return grid_; }
  const TetClusters& clusters() const { return *clusters_; }
  const CarriedFields& fields() const { return fields_; }
  // MeshData::cut_memory; empty where it does not belong to the mesh.
  std::span<const std::byte> cut_memory() const { return cut_memory_; }

 private:
  const TetMesh mesh_;
  const BoundaryGrid grid_;
  std::optional<const TetClusters> clusters_;
  const CarriedFields fields_;
  std::vector<std::byte> cut_memory_;
};

}  // namespace incise::core
