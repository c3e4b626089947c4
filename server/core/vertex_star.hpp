#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "server/core/quality.hpp"
#include "server/core/tet_mesh.hpp"

namespace incise::core {

// The star of one vertex, laid out to ask again and again what it would be worth with the vertex elsewhere.
class VertexStar {
 public:
  struct Corner {
    TetId tet;
    std::array<VertexId, 3> others;  // (v, others) is positively oriented
    std::array<Vec3, 3> points;
    bool may_flatten;  // all others lie on the swept surface
  };

  // Reads the star of v. on_surface(vertex) says whether a vertex lies on the swept surface.
  template <class OnSurface>
  void gather(const TetMesh& mesh, VertexId v, OnSurface on_surface) {
    mesh.star(v, corners_ids_);
    position_ = mesh.position(v);
    local_h_ = mesh.local_h(v);
    corners_.clear();
    walls_.clear();
    wall_area_ = {};
    for (std::uint32_t id : corners_ids_) {
      Corner& corner = corners_.emplace_back();
      corner.tet = id >> 2;
      const int i = static_cast<int>(id & 3u);
      const auto& vertices = mesh.vertices(corner.tet);
      corner.may_flatten = true;
      for (int k = 0; k < 3; ++k) {
        const VertexId other = vertices[kFaceVertices[i][k]];
        corner.others[k] = other;
        corner.points[k] = mesh.position(other);
        corner.may_flatten = corner.may_flatten && on_surface(other);
      }
      for (int f = 0; f < 4; ++f) {
        if (f == i) continue;
        const TetId beyond = mesh.neighbor(corner.tet, f);
        // What lies between two materials is as fixed as what lies between tissue and air.
        if (beyond != kNone && mesh.region(beyond) == mesh.region(corner.tet)) continue;
        const auto& k = kFaceVertices[f];
        const Vec3& a = mesh.position(vertices[k[0]]);
        const Vec3 twice = cross(mesh.position(vertices[k[1]]) - a, mesh.position(vertices[k[2]]) - a);
        walls_.push_back(normalized(twice));
        wall_area_ += 0.5 * twice;
      }
    }
  }

  const std::vector<Corner>& corners() const { return corners_; }
  const Vec3& position() const { return position_; }
  // The mesh width at the vertex, m.
  double local_h() const { return local_h_; }
  // Unit normals of the boundary faces at the vertex (and of faces between two regions).
  const std::vector<Vec3>& walls() const { return walls_; }
  bool on_boundary() const { return !walls_.empty(); }

  // The worst measure (quality.hpp) in the star with the vertex at p; stops early beyond `limit`. Tetrahedra that
  // would be flat on the surface do not count: they are appended to `flat`. `thickness` is what counts as flat, m.
  double worst_at(const Vec3& p, double limit, double thickness, std::vector<TetId>& flat) const;
  // The worst measure as it stands.
  double worst_now() const;
  // Whether the boundary would stay where it is, to within a small part of the mesh width, with the vertex at p: the
  // distance of its faces' planes, and the volume that is won or lost.
  bool keeps_boundary(const Vec3& p) const;

 private:
  Vec3 position_;
  double local_h_ = 0;
  std::vector<std::uint32_t> corners_ids_;
  std::vector<Corner> corners_;
  std::vector<Vec3> walls_;
  Vec3 wall_area_;  // the sum of the boundary faces' area vectors
};

}  // namespace incise::core
