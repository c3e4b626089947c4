#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"

namespace incise::mesh_io {

// The pair of TetGen files that `path` names: by either file, or by the name both share.
struct TetgenPaths {
  std::filesystem::path node, ele;
};
TetgenPaths tetgen_paths(const std::filesystem::path& path);

// Reads NAME.node and NAME.ele (TetGen manual 1.5, sections 5.2.1 and 5.2.4): first index 0 or 1, comments,
// point attributes and boundary markers (ignored), four or ten nodes a tetrahedron (the corners are kept),
// the first attribute of a tetrahedron as its region. The tetrahedra are as the file has them: see
// repair_tets. `index_base` is set to the file's first index, `warnings` gets a line for each thing that is
// dropped.
core::MeshData read_tetgen(const std::filesystem::path& path, int& index_base,
                           std::vector<std::string>& warnings);

// Writes NAME.node and NAME.ele, first index 0, coordinates in 17 significant digits (they read back as the
// same doubles), regions as the attribute. `regions` is empty or as long as `tets`.
void write_tetgen(const std::filesystem::path& path, std::span<const core::Vec3> positions,
                  std::span<const std::array<core::VertexId, 4>> tets, std::span<const std::int32_t> regions);

}  // namespace incise::mesh_io
