#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/stroke/blade.hpp"
#include "server/haptics/probe_work.hpp"
#include "server/haptics/surface_tree.hpp"

namespace incise::haptics {

// A 3 x 3 matrix by its columns.
struct Mat3 {
  core::Vec3 x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1};

  core::Vec3 operator*(const core::Vec3& v) const noexcept { return v.x * x + v.y * y + v.z * z; }
  // The transposed matrix times v.
  core::Vec3 transposed(const core::Vec3& v) const noexcept { return {dot(x, v), dot(y, v), dot(z, v)}; }
};

// Where tissue is now and where it is at rest, around one place: now = now0 + now_from_rest (rest - rest0), the
// deformation gradient F of a tetrahedron and its inverse.
struct LocalMap {
  core::Vec3 rest0, now0;
  Mat3 now_from_rest, rest_from_now;

  core::Vec3 rest(const core::Vec3& now) const noexcept { return rest0 + rest_from_now * (now - now0); }
  core::Vec3 now(const core::Vec3& rest) const noexcept { return now0 + now_from_rest * (rest - rest0); }
  // Of a plane's normal, by the inverse transpose; unit.
  core::Vec3 normal_now(const core::Vec3& normal) const noexcept {
    return normalized(rest_from_now.transposed(normal));
  }
};

// A blade's edge in the body at rest: straight between places, which go from heel to tip.
struct RestLine {
  struct Place {
    double at = 0;    // parameter on the edge: 0 at the heel, 1 at the tip
    core::Vec3 rest;  // where the material there is at rest; outside the body continued from its boundary
    core::TetId tet = core::kNone;  // of the body as loaded, that has it; outside the nearest that is known
    bool inside = false, known = false;  // known: whether it is inside. Not: somebody has to look
    bool gap = false;  // between the sides of an open cut: no tissue, though at rest there is some
  };
  static constexpr int kMostPieces = 8, kMostPlaces = 3 * kMostPieces + 1;
  std::array<Place, kMostPlaces> places;
  int count = 0;
  double length_m = 0;    // of the edge, now
  bool deformed = false;  // false: two places, where they are

  std::span<const Place> all() const { return std::span(places).first(static_cast<std::size_t>(count)); }
  core::Vec3 rest(double at) const noexcept;
  // The tetrahedron of the nearest place.
  core::TetId tet(double at) const noexcept;
};

// Takes places of a deformed body to the body at rest and back, through the tetrahedra of the mesh that is cut, as they
// are now. Nothing is kept from frame to frame and nothing is prepared when the body deforms, so a frame costs the same in any
// mesh.
//
// From rest to now each tetrahedron is affine. The other way it is looked for by Newton's method on this piecewise affine
// map: take the place back by the map of one tetrahedron, walk through the body at rest to where that leads, go on with the tetrahedron
// there. It ends when a tetrahedron's map leads into itself. Where the sides of a cut have parted, two tetrahedra lead into
// each other, for ever: this place is in the gap. The first place of an edge begins with the nearest of kAnchors
// tetrahedra at the boundary, each other one with that of the place before.
//
// Thread: one, at a time.
class RestMap {
 public:
  // Both must outlive this.
  RestMap(const core::TetMesh& loaded, const SurfaceTree& surface);

  // The mesh that is cut and deforms; it must outlive this or the next call.
  void follow(const core::TetMesh& now) { now_ = &now; }
  bool deformed() const { return now_ != nullptr && now_->deformed(); }

  RestLine line(const core::BladeLine& line, ProbeWork& work) const noexcept;
  // Which tetrahedron of the mesh as it is now holds a place.
  struct Hold {
    core::TetId tet = core::kNone, loaded = core::kNone;  // the latter of the body as loaded
    std::array<double, 4> weights{};                      // barycentric coordinates of the place in `tet`
    double most = 0;  // the largest of them without sign: above 1 it is beside it
  };
  // `from`: a tetrahedron of the body as loaded near the place, or kNone.
  Hold hold(const core::Vec3& p, core::TetId from, ProbeWork& work) const noexcept;
  // Null before follow().
  const core::TetMesh* now() const { return now_; }
  // The map of a tetrahedron of the body as loaded, whatever a cut has made of it since.
  LocalMap map(core::TetId loaded) const noexcept;

 private:
  static constexpr std::size_t kAnchors = 64;
  static constexpr int kMostTurns = 12;
  struct Anchor {
    core::TetId tet;
    core::VertexId vertex;
  };
  RestLine::Place find(const core::Vec3& p, core::TetId from, ProbeWork& work) const noexcept;
  core::TetId nearest_anchor(const core::Vec3& p) const noexcept;

  const core::TetMesh& loaded_;
  const SurfaceTree& surface_;
  const core::TetMesh* now_ = nullptr;
  std::vector<Anchor> anchors_;
};

// The tetrahedron of `body` that contains p; kNone outside. A ray from p finds the surface, and a walk leads back from there.
// O(log surface + tetrahedra along the ray).
core::TetId locate(const core::TetMesh& body, const SurfaceTree& surface, const core::Vec3& p,
                   ProbeWork& work) noexcept;

}  // namespace incise::haptics
