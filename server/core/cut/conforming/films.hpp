#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"
#include "server/core/cut/conforming/cut_faces.hpp"

namespace incise::core {

// A point that stands for the side of the surface that a tetrahedron is on.
Vec3 reference_point(const CutContext& cut, TetId t);

// Whether the middle of a tetrahedron is within `reach` of the surface, or of an older cut that it lies at.
bool is_shallow(const CutContext& cut, TetId t, double reach);

// Whether `count` tetrahedra may be a film or a part of one, when `inner` of them reach into the tissue.
inline bool may_be_film(std::size_t inner, std::size_t count) {
  return inner <=
         count / tolerance::kFilmToInner + (count > tolerance::kMaxRaggedIsland ? tolerance::kFilmInner : 0);
}

// The size of some tetrahedra that hang together, by which a film is told from a part of the tissue.
struct Extent {
  double volume_m3 = 0, area_m2 = 0, cut_area_m2 = 0;

  // A face of its surface, at the boundary or about to open.
  void add_face(const TetMesh& mesh, HalfFace h) {
    const double face_m2 = 0.5 * length(mesh.twice_area(h));
    area_m2 += face_m2;
    const bool opens = mesh.opposite(h) != kNone;
    if (opens || (mesh.cut_mask(tet_of(h)) >> face_of(h) & 1) != 0) cut_area_m2 += face_m2;
  }
  bool is_between_cuts() const { return cut_area_m2 >= tolerance::kBetweenCuts * area_m2; }
  // Whether they are too small to be a part of the tissue, whatever their shape.
  bool is_crumb(double h) const { return volume_m3 < tolerance::kLeastPart_h3 * h * h * h; }
  // The largest volume that a film with that surface has. A film has two sides, and one of them at least is a cut: what sticks out of the
  // body may be as thin.
  double film_m3(double h) const {
    return (is_between_cuts() ? tolerance::kOne_h : tolerance::kFilm_h) * h *
           std::min(0.5 * area_m2, cut_area_m2);
  }
  // Of one that lies along a cut, or between cuts, if no part of it is deep.
  double shallow_m3(double h) const {
    if (cut_area_m2 < tolerance::kAlongCut * area_m2) return 0;
    return (is_between_cuts() ? tolerance::kUneven_h : tolerance::kOne_h) * h *
           std::min(0.5 * area_m2, cut_area_m2);
  }
};

// Tells films from parts of the tissue, among tetrahedra that hang together.
class Films {
 public:
  explicit Films(const CutContext& cut) : cut_(cut), mesh_(cut.mesh), faces_(cut), known_(kKnown) {}

  // To be called when the mesh has changed, or the surface.
  void begin() {
    faces_.begin();
    ++serial_;
  }

  // Whether a tetrahedron may be part of a film: none of it is inside the tissue, but for what is so near to the surface that it is one with it. Hands leave
  // films of many small tetrahedra.
  bool may_be_film(TetId t);

  // Whether `least_h3` of them is farther than kDeep_h from the cuts.
  enum class Cuts { kThisStroke, kAll };
  bool is_deep(std::span<const TetId> tets, double least_h3, Cuts cuts);
  bool is_film(const Extent& extent, std::span<const TetId> tets);

 private:
  // What has been found out of a tetrahedron: where hands wander it is looked at some twenty times, as part of another film each time.
  struct Known {
    static constexpr std::uint8_t kUnknown = 0xff;
    std::uint64_t serial = 0;
    TetId tet = kNone;
    std::uint8_t may_be_film = kUnknown;
    // How many of its points are farther than kDeep_h from this stroke's cuts, and from all of them.
    std::array<std::uint8_t, 2> deep{kUnknown, kUnknown};
  };
  // Each has its place; one that another takes is found out again.
  static constexpr std::size_t kKnown = 2048;

  Known& known(TetId t);
  int count_deep(TetId t, Cuts cuts);
  bool is_near_cut(TetId t, const Vec3& p, double reach, Cuts cuts);

  const CutContext& cut_;
  const TetMesh& mesh_;
  CutFaces faces_;
  std::uint64_t serial_ = 1;
  std::vector<Known> known_;
};

}  // namespace incise::core
