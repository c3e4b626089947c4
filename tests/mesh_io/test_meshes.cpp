#include "tests/mesh_io/test_meshes.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>

#include "server/mesh_io/mesh_error.hpp"

namespace incise::mesh_io::testing {

using core::VertexId;

TestDirectory::TestDirectory() {
  std::string name = (std::filesystem::temp_directory_path() / "incise-test-XXXXXX").string();
  if (!mkdtemp(name.data())) throw std::runtime_error("mkdtemp " + name);
  path_ = name;
}

TestDirectory::~TestDirectory() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}

std::filesystem::path TestDirectory::write(std::string_view name, std::string_view bytes) const {
  std::ofstream(path_ / name, std::ios::binary) << bytes;
  return path_ / name;
}

ScopedVariable::ScopedVariable(const char* name, const std::string& value) : name_(name) {
  const char* before = std::getenv(name);
  was_set_ = before != nullptr;
  if (before) before_ = before;
  setenv(name, value.c_str(), 1);
}

ScopedVariable::~ScopedVariable() {
  if (was_set_) {
    setenv(name_, before_.c_str(), 1);
  } else {
    unsetenv(name_);
  }
}

std::filesystem::path real_meshes() {
  const char* data = std::getenv("INCISE_DATA");
  return data && *data ? std::filesystem::path(data) / "meshes" : std::filesystem::path();
}

Surface cube(const core::Vec3& low, double side) {
  Surface surface;
  for (int i = 0; i < 8; ++i) {
    surface.positions.push_back(low + side * core::Vec3{double(i & 1), double(i >> 1 & 1), double(i >> 2)});
  }
  surface.triangles = {{0, 2, 3}, {0, 3, 1}, {4, 5, 7}, {4, 7, 6}, {0, 1, 5}, {0, 5, 4},
                       {2, 6, 7}, {2, 7, 3}, {0, 4, 6}, {0, 6, 2}, {1, 3, 7}, {1, 7, 5}};
  return surface;
}

Surface inside_out(Surface surface) {
  for (auto& t : surface.triangles) std::swap(t[0], t[1]);
  return surface;
}

Surface both(Surface a, const Surface& b) {
  const auto offset = static_cast<VertexId>(a.positions.size());
  a.positions.insert(a.positions.end(), b.positions.begin(), b.positions.end());
  for (auto t : b.triangles) {
    for (VertexId& v : t) v += offset;
    a.triangles.push_back(t);
  }
  return a;
}

core::MeshData cube_mesh(int n) {
  core::MeshData mesh;
  const auto vertex = [n](int i, int j, int k) {
    return static_cast<VertexId>(i + (n + 1) * (j + (n + 1) * k));
  };
  for (int k = 0; k <= n; ++k) {
    for (int j = 0; j <= n; ++j) {
      for (int i = 0; i <= n; ++i) mesh.positions.push_back({double(i), double(j), double(k)});
    }
  }
  constexpr int kPaths[6][4] = {{0, 1, 3, 7}, {0, 3, 2, 7}, {0, 2, 6, 7},
                                {0, 6, 4, 7}, {0, 4, 5, 7}, {0, 5, 1, 7}};
  for (int k = 0; k < n; ++k) {
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < n; ++i) {
        for (const auto& path : kPaths) {
          std::array<VertexId, 4> tet;
          for (std::size_t c = 0; c < 4; ++c) {
            tet[c] = vertex(i + (path[c] & 1), j + (path[c] >> 1 & 1), k + (path[c] >> 2));
          }
          mesh.tets.push_back(tet);
        }
      }
    }
  }
  return mesh;
}

std::string node_text(const core::MeshData& mesh, int base) {
  std::string text = std::to_string(mesh.positions.size()) + " 3 0 0\n";
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const core::Vec3& p = mesh.positions[i];
    text += std::to_string(static_cast<int>(i) + base) + " " + to_text(p.x) + " " + to_text(p.y) + " " +
            to_text(p.z) + "\n";
  }
  return text;
}

std::string ele_text(const core::MeshData& mesh, int base) {
  std::string text = std::to_string(mesh.tets.size()) + (mesh.regions.empty() ? " 4 0\n" : " 4 1\n");
  for (std::size_t i = 0; i < mesh.tets.size(); ++i) {
    text += std::to_string(static_cast<int>(i) + base);
    for (const VertexId v : mesh.tets[i]) text += " " + std::to_string(static_cast<int>(v) + base);
    if (!mesh.regions.empty()) text += " " + std::to_string(mesh.regions[i]);
    text += "\n";
  }
  return text;
}

std::string error_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const MeshError& error) {
    return error.what();
  } catch (const std::exception& error) {
    ADD_FAILURE() << "not a MeshError: " << error.what();
    return "";
  }
  ADD_FAILURE() << "no error";
  return "";
}

}  // namespace incise::mesh_io::testing
