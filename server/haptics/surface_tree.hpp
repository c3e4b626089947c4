#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/stroke/blade.hpp"
#include "server/haptics/probe_work.hpp"

namespace incise::haptics {

// Where a line passes through the surface.
struct Crossing {
  double at;  // parameter on the line: 0 at the heel, 1 at the tip
  core::HalfFace face;
  bool entering;
};

// A point on the surface.
struct SurfacePoint {
  core::Vec3 point;   // m
  core::Vec3 normal;  // unit, out of the tissue
  double distance_m;
  core::HalfFace face;  // that it lies on
};

// The boundary of a body as it is now, as triangles in a tree of boxes. Built in O(n log n) for n triangles; 140 bytes
// each. Does not follow what becomes of the mesh. Thread: any, once it is built.
class SurfaceTree {
 public:
  explicit SurfaceTree(const core::TetMesh& mesh);

  // Fills `found` with the crossings in the order of the line, and returns how many there are; what does not fit is
  // left out. O(log n + crossings), within the bounds of `work`.
  std::size_t crossings(const core::BladeLine& line, std::span<Crossing> found,
                        ProbeWork& work) const noexcept;
  // The first crossing, if there is one.
  std::optional<Crossing> first_crossing(const core::BladeLine& line, ProbeWork& work) const noexcept;
  // The point of the surface nearest to p within `radius`, m.
  std::optional<SurfacePoint> nearest(const core::Vec3& p, double radius, ProbeWork& work) const noexcept;

  // How many boundary faces there are, and each in the tree's order: those near each other have near numbers.
  std::size_t faces() const { return triangles_.size(); }
  core::HalfFace face(std::size_t i) const { return triangles_[i].face; }

  // A box that holds all of it; all zero where there is nothing.
  core::Vec3 low() const { return nodes_.empty() ? core::Vec3{} : nodes_[0].low; }
  core::Vec3 high() const { return nodes_.empty() ? core::Vec3{} : nodes_[0].high; }

 private:
  struct Triangle {
    core::Vec3 a, b, c;
    core::HalfFace face;
  };
  // Its left child is the next node. A leaf has triangles first ... first + count.
  struct Node {
    core::Vec3 low, high;
    std::uint32_t first = 0, count = 0, right = 0;
    int axis = 0;
  };
  void build(std::uint32_t begin, std::uint32_t end);
  // Calls visit(triangle) for those in boxes that the line meets before parameter `to`, roughly in its order; visit may
  // lower `to`.
  template <class Visit>
  void along(const core::BladeLine& line, double& to, ProbeWork& work, Visit visit) const noexcept;

  std::vector<Triangle> triangles_;
  std::vector<Node> nodes_;
};

}  // namespace incise::haptics
