#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"
#include "server/mesh_io/token_reader.hpp"

namespace incise::mesh_io {

// Builds a mesh from a file: node numbers become indices, whatever number the file starts at.
class TetCollector {
 public:
  explicit TetCollector(TokenReader& in) : in_(in) {}

  // Numbers may come in any order, and with gaps.
  void add_node(std::int64_t number, const core::Vec3& position);
  // Reads three coordinates.
  core::Vec3 read_position();
  // Ends the list of nodes. Fails if a number occurred twice.
  void end_nodes();
  std::size_t node_count() const { return mesh_.positions.size(); }

  core::VertexId vertex(std::int64_t number) const;  // fails if there is no such node
  void add_tet(const std::array<core::VertexId, 4>& corners, std::int64_t region);
  // Which faces of the last tetrahedron an earlier cut opened, as the array kCutMask says it: MeshData::cut_masks.
  void note_cut_faces(double mask);
  // MeshData::cut_memory, from the array kCutMemory. Values that are no bytes are none.
  void note_cut_memory(std::span<const double> bytes);
  // Reads the number of a region or material: an integer or a whole float.
  std::int32_t checked_region(std::int64_t region) const;
  void note_higher_order() { ++higher_order_; }

  core::MeshData& mesh() { return mesh_; }
  // The mesh; without regions if all are 0. Fails if there is no tetrahedron.
  core::MeshData finish(std::vector<std::string>& warnings, std::string_view skipped);

 private:
  TokenReader& in_;
  core::MeshData mesh_;
  // Node numbers: first + index while they count up by one, else sorted pairs.
  std::int64_t first_ = 0;
  bool dense_ = true;
  std::vector<std::int64_t> numbers_;  // of each vertex, while not dense
  std::vector<std::pair<std::int64_t, core::VertexId>> sorted_;
  std::size_t higher_order_ = 0;
  bool misread_cut_faces_ = false;
};

}  // namespace incise::mesh_io
