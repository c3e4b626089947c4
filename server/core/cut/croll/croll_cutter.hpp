#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "server/core/cut/cutter.hpp"
#include "server/core/mesh/tet_mesh.hpp"

namespace incise::core {

// The policy `croll`: Menion Croll, "A New Approach to Cutting Tetrahedral Meshes", 2007, as written: the
// baseline that `conforming` is compared with. Five steps for each swept segment, each over the whole mesh
// (eq. 15-17): identify the cut plane, classify, move vertices to the plane, split them, remove what became
// flat.
//
// Its faults are the paper's, and are left in for reports to count (measure.hpp): moves do not look at the
// quality of the tetrahedra around, so some end up inverted; a segment shorter than a tetrahedron cuts little
// or nothing (the paper's section 5).
//
// The cut is bounded by the back and the front plane only, as in the paper: along the blade's direction it
// goes on beyond heel and tip, through the whole body.
//
// Where the paper leaves a choice, or fails:
// - Blade lines that are not coplanar (section 5): two planes, those of the triangles of struct Batch. The
// diagonal
//   that they share is the front line of the first and the back line of the second.
// - Rounding: a vertex within kOnPlane_h of a plane is on it. On the cut plane it counts as moved, so that a
// cut which
//   meets vertices exactly still splits them; on the front or back plane it is between the two.
// - A tetrahedron is affected if at least one of its vertices is between front and back plane; only such
// move.
// - The normal of the surface at a vertex is the mean over its boundary faces, weighted by area, without cut
// faces
//   where there are others. Where it is within kParallel of the cut plane's normal the line of intersection
//   is too far away to move to, and where it is zero (a crack front) there is no surface: eq. 10 serves both.
// - A tetrahedron that reaches through front and back plane moves its vertices to the nearer of the two.
// - Splitting gives each vertex one copy for each face-connected component of its star (TetMesh::open_faces),
// which
//   is the paper's "association by side" wherever that is a manifold.
//
// The work of one plane is not interrupted; the budget is looked at between planes. Thread: one, at a time.
class CrollCutter final : public Cutter {
 public:
  explicit CrollCutter(TetMesh& mesh) : mesh_(mesh) {}
  void begin(const Batch& batch) override;
  // O(vertices + tetrahedra) for each plane, and charges as much.
  Progress advance(WorkBudget& budget) override;
  // events: tetrahedra that the cut plane intersects; snaps: vertices moved. max_deviation_h is from the
  // plane.
  const CutCounts& counts() const override { return counts_; }

  // All in units of the mean edge length, or dimensionless.
  static constexpr double kOnPlane_h = 1e-6;
  static constexpr double kCoplanar_h = 1e-3;  // the fourth point of a quad is off the plane of three by less
  static constexpr double kParallel = 0.1;     // sine of the angle between two planes

 private:
  // The Hessian normal form of a plane (eq. 4-6): n . x = -p with |n| = 1.
  struct Plane {
    Vec3 n;
    double p = 0;
    double distance(const Vec3& v) const { return dot(n, v) + p; }  // D of eq. 8
  };
  // What one segment, or one triangle of it, cuts along. Back and front plane point in the blade's direction
  // of motion: what is cut has D >= 0 to the back plane and D <= 0 to the front plane.
  struct Sweep {
    Plane cut, back, front;
  };
  // The three signed distances of a vertex, m; within rounding they are exactly zero.
  struct Distances {
    double cut = 0, back = 0, front = 0;
  };

  static bool make_sweep(const BladeLine& back, const BladeLine& front, double h, Sweep& sweep);
  void add_segment(const BladeLine& back, const BladeLine& front);
  Distances classify(const Sweep& sweep, const Vec3& v) const;
  bool between(VertexId v) const { return distances_[v].back >= 0 && distances_[v].front <= 0; }
  int side(TetId t) const;
  Vec3 surface_normal(VertexId v);
  Vec3 moved_to(const Plane& plane, VertexId v);
  void cut(const Sweep& sweep);
  void choose_moves();
  void move_to_cut_plane(const Sweep& sweep);
  void move_to_ends(const Sweep& sweep);
  void split(const Sweep& sweep);
  void remove_flat();

  TetMesh& mesh_;
  CutCounts counts_;
  std::vector<Sweep> sweeps_;  // of the batch
  std::size_t next_ = 0;       // in sweeps_

  // For the sweep at work, by vertex and tetrahedron slot.
  std::vector<Distances> distances_;
  std::vector<std::uint8_t> moved_;
  std::vector<std::int8_t> side_;  // alpha of eq. 9, of tetrahedra that a moved vertex may belong to
  std::vector<VertexId> moves_;    // ascending
  std::vector<Vec3> targets_;      // of moves_
  std::vector<HalfFace> faces_;
  std::vector<std::uint32_t> star_;
};

}  // namespace incise::core
