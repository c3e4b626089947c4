#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"
#include "server/mesh_io/token_reader.hpp"

namespace incise::mesh_io {

// Builds the mesh that a file describes: numbers of nodes become indices, whatever the file counts from.
class TetCollector {
 public:
  explicit TetCollector(TokenReader& in) : in_(in) {}

  // Numbers come in any order, and with gaps.
  void add_node(std::int64_t number, const core::Vec3& position);
  // Reads three coordinates.
  core::Vec3 read_position();
  // All nodes are there. Fails where a number came twice.
  void end_nodes();
  std::size_t node_count() const { return mesh_.positions.size(); }

  core::VertexId vertex(std::int64_t number) const;  // fails where there is no such node
  void add_tet(const std::array<core::VertexId, 4>& corners, std::int64_t region);
  // Reads a number of region, or material, that the file gives as an integer or a whole float.
  std::int32_t checked_region(std::int64_t region) const;
  void note_higher_order() { ++higher_order_; }

  core::MeshData& mesh() { return mesh_; }
  // The mesh; without regions where they are all 0. Fails where there is no tetrahedron.
  core::MeshData finish(std::vector<std::string>& warnings, std::string_view skipped);

 private:
  TokenReader& in_;
  core::MeshData mesh_;
  // Node numbers: first + index as long as they count up by one, else sorted pairs.
  std::int64_t first_ = 0;
  bool dense_ = true;
  std::vector<std::int64_t> numbers_;  // of each vertex, while not dense
  std::vector<std::pair<std::int64_t, core::VertexId>> sorted_;
  std::size_t higher_order_ = 0;
};

}  // namespace incise::mesh_io
