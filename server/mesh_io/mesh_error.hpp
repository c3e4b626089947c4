#pragma once

#include <stdexcept>
#include <string>

#include "server/core/geometry/vec3.hpp"

namespace incise::mesh_io {

// What is wrong with a mesh file, or with what was asked of it: one line that names the file (and the line
// where there is one), what is wrong, where (indices as the file counts them, and coordinates), and what to
// do.
class MeshError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// "(0.1, -0.25, 3)": nine significant digits, which tell any two points of a mesh apart.
std::string to_text(const core::Vec3& point);
// The number in the fewest digits that read back as the same double.
std::string to_text(double number);

}  // namespace incise::mesh_io
