#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "server/core/geometry/quality.hpp"
#include "server/core/mesh/tet_mesh.hpp"

namespace incise::core {

// The star of one vertex, laid out to evaluate its quality with the vertex at many trial positions.
class VertexStar {
 public:
  struct Corner {
    TetId tet;
    std::array<VertexId, 3> others;  // (v, others) is positively oriented
  };
  struct Wall {
    Vec3 normal;        // unit, outward
    double twice_area;  // m^2
    bool cut;           // a cut has opened it
  };

  // Reads the star of v. on_surface(vertex) says whether a vertex lies on the swept surface.
  template <class OnSurface>
  void gather(const TetMesh& mesh, VertexId v, OnSurface on_surface) {
    gather(mesh, v);
    std::uint32_t i = 0;
    for (const Corner& corner : corners_) {
      if (on_surface(corner.others[0]) && on_surface(corner.others[1]) && on_surface(corner.others[2]))
        flattenable_.push_back(i);
      ++i;
    }
  }

  const std::vector<Corner>& corners() const { return corners_; }
  // Where others[k] of the corner is.
  Vec3 point(std::size_t corner, int k) const {
    const auto& p = lanes_[corner / 4].p;
    const std::size_t lane = corner % 4, row = 3 * static_cast<std::size_t>(k);
    return {p[row][lane], p[row + 1][lane], p[row + 2][lane]};
  }
  const Vec3& position() const { return position_; }
  // The mesh width at the vertex, m.
  double local_h() const { return local_h_; }
  // The boundary faces at the vertex, and faces between two regions.
  const std::vector<Wall>& walls() const { return walls_; }
  // The sum of their area vectors, m^2.
  const Vec3& wall_area() const { return wall_area_; }
  bool on_boundary() const { return !walls_.empty(); }
  // Whether a cut ends at the vertex: the faces of both its sides are here.
  bool ends_cut() const;

  // The worst measure (quality.hpp) in the star with the vertex at p; stops early beyond `limit`. Tetrahedra that
  // would be flat on the surface do not count: they are appended to `flat`. `thickness` is what counts as flat, m.
  double worst_at(const Vec3& p, double limit, double thickness, std::vector<TetId>& flat) const;
  // The worst measure as it stands.
  double worst_now() const;
  // Whether the boundary would stay where it is, to within a small part of the mesh width, with the vertex at p: the
  // distance of its faces' planes, and the volume that is won or lost, which is a small part of the star's, too.
  bool keeps_boundary(const Vec3& p) const;

 private:
  double volume() const;
  // The points of four corners, side by side for vector instructions: rows are the coordinates of others[0], [1], [2].
  struct alignas(32) Lanes {
    double p[9][4];
  };
  friend struct LaneKernels;

  void gather(const TetMesh& mesh, VertexId v);
  void add_walls(const TetMesh& mesh, TetId t, int i);
  void leave_out(std::size_t corner) const;

  Vec3 position_;
  double local_h_ = 0;
  std::vector<std::uint32_t> corner_ids_;
  std::vector<Corner> corners_;
  std::vector<Lanes> lanes_;  // the last one is filled up with copies of the last corner
  // The lanes that decided the last rejection: they usually decide the next one.
  mutable std::size_t worst_lanes_ = 0;
  std::vector<std::uint32_t> flattenable_;  // corners whose others all lie on the swept surface
  mutable std::vector<std::uint8_t>
      flat_lanes_;  // scratch: bit k of the i-th: lane k of lanes_[i] would be flat
  std::vector<Wall> walls_;
  Vec3 wall_area_;
  mutable double volume_ = -1;  // below 0: not known yet
};

}  // namespace incise::core
