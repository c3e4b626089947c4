#pragma once

#include <stdexcept>
#include <string>

#include "server/core/geometry/vec3.hpp"

namespace incise::mesh_io {

// A mesh file, or a request, that cannot be used. The text is one line: the file (and the line, if there is
// one), what is wrong, where (indices as in the file, and coordinates), and what to
// do.
class MeshError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// "(0.1, -0.25, 3)": nine significant digits, enough to distinguish any two points of a mesh.
std::string to_text(const core::Vec3& point);
// The number with the fewest digits that read back as the same double.
std::string to_text(double number);

}  // namespace incise::mesh_io
