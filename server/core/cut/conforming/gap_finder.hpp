#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "server/core/cut/conforming/cut_context.hpp"
#include "server/core/cut/conforming/hole_finder.hpp"

namespace incise::core {

// A face that may hold two parts together. Those that would put most tissue on the wrong side are judged first, and of those on the surface the largest: what
// need not open stays closed, and the others are judged with it.
struct Gap {
  // kRib: between a sweep and the boundary, both sides are on one side of the sweep. kNeck: it is farther off, or less is known of it.
  enum class Kind { kAcross, kRib, kNeck };
  double off_m;
  HalfFace face;
  bool meets;  // an older cut
  // Judged before, or left by an older cut: then a film is told by its mean thickness alone.
  bool by_thickness;
  Kind kind;
  double area_m2 = 0;  // twice
  bool operator<(const Gap& other) const {
    const double wrong_m3 = off_m * area_m2, other_wrong_m3 = other.off_m * other.area_m2;
    if (wrong_m3 != other_wrong_m3) return wrong_m3 > other_wrong_m3;
    return area_m2 != other.area_m2 ? area_m2 > other.area_m2 : face < other.face;
  }
};

// Says whether a closed face all of whose vertices lie at the boundary may be a gap: by where it lies, not by what it holds together. Changes nothing.
class GapFinder {
 public:
  explicit GapFinder(CutContext& cut) : cut_(cut), mesh_(cut.mesh), holes_(cut) {}

  // A batch begins to close gaps; no vertex moves until it has.
  void begin() { serial_ = cut_.workspace.next_serial(); }
  // Whether the face may be a gap or a rib. Fills in the rest of `gap`, but for its area.
  bool may_close(Gap& gap);
  // Whether one that may_close() refuses may be a neck. Fills in how far off it is.
  bool may_be_neck(Gap& gap);
  // Whether p is near what was swept.
  bool is_near(const Vec3& p) {
    double off_m = 0;
    return is_near(p, off_m);
  }

 private:
  // How far a vertex is off the surface; INFINITY: too far.
  struct Off {
    std::uint32_t serial = 0;  // of the batch
    VertexId vertex = kNone;
    double off_m = 0;
  };

  double off_surface_m(VertexId v);
  bool lies_away(VertexId v);
  bool is_near(VertexId v, double& off_m);
  bool is_near(const Vec3& p, double& off_m);
  bool is_at_end(const Vec3& p);

  CutContext& cut_;
  const TetMesh& mesh_;
  HoleFinder holes_;
  std::uint32_t nearest_ = 0;  // the surface's triangle that is_near() has found
  // What is_near() and off_surface_m() have found: some faces share a vertex. Vertices share places.
  static constexpr std::size_t kOffs = 256;
  std::array<Off, kOffs> near_, far_;
  std::uint32_t serial_ = 0;
};

}  // namespace incise::core
