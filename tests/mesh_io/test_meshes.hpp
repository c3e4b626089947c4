#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <string_view>

#include "server/core/mesh/mesh_data.hpp"
#include "server/mesh_io/surface.hpp"

namespace incise::mesh_io::testing {

// A directory of its own for one test, removed at the end.
class TestDirectory {
 public:
  TestDirectory();
  ~TestDirectory();
  TestDirectory(const TestDirectory&) = delete;
  TestDirectory& operator=(const TestDirectory&) = delete;

  std::filesystem::path operator/(std::string_view name) const { return path_ / name; }
  // Writes a file and gives its path.
  std::filesystem::path write(std::string_view name, std::string_view bytes) const;

 private:
  std::filesystem::path path_;
};

// Sets an environment variable for the time of a test.
class ScopedVariable {
 public:
  ScopedVariable(const char* name, const std::string& value);
  ~ScopedVariable();
  ScopedVariable(const ScopedVariable&) = delete;
  ScopedVariable& operator=(const ScopedVariable&) = delete;

 private:
  const char* name_;
  std::string before_;
  bool was_set_;
};

// The directory of real meshes, $INCISE_DATA/meshes; empty where the variable is not set.
std::filesystem::path real_meshes();

// The unit cube: 8 vertices, 12 triangles that face outwards, moved and scaled.
Surface cube(const core::Vec3& low = {0, 0, 0}, double side = 1);
// Turns all triangles of a surface over.
Surface inside_out(Surface surface);
// Both in one, unconnected.
Surface both(Surface a, const Surface& b);

// n x n x n cubes of side 1, six positive tetrahedra each.
core::MeshData cube_mesh(int n);

// The text of .node and .ele files for a mesh.
std::string node_text(const core::MeshData& mesh, int base = 0);
std::string ele_text(const core::MeshData& mesh, int base = 0);

// What `action` throws as MeshError; fails the test, and gives "", where it throws nothing or something else.
std::string error_of(const std::function<void()>& action);

}  // namespace incise::mesh_io::testing
