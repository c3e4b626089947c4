#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/stroke/blade.hpp"
#include "server/core/stroke/swept_surface.hpp"

namespace incise::core {

// Facts about a whole mesh, for reports and tests: everything here costs O(mesh) and belongs in no frame.

// A piece of this many tetrahedra or fewer is an island: debris of a cut rather than a part of the body.
inline constexpr std::uint32_t kLargestIsland = 8;

struct CutReport {
  std::uint32_t vertices = 0;        // that a live tetrahedron has
  std::uint32_t tets = 0;            // live
  std::uint32_t pieces = 0;          // components of live tetrahedra that are connected through faces
  std::uint32_t islands = 0;         // those of the pieces with kLargestIsland tetrahedra or fewer
  std::uint32_t largest_piece = 0;   // tetrahedra
  std::uint32_t boundary_faces = 0;  // faces without a neighbour, cut faces included
  std::uint32_t cut_sides = 0;       // faces of live tetrahedra that a cut opened: two for each opened face
  std::uint32_t cut_faces =
      0;                // cut_sides / 2, rounded up: a removed tetrahedron leaves faces with one side only
  double cut_area = 0;  // of one side (half of the area of all cut_sides), m^2
  double volume = 0;    // sum of the signed volumes, m^3
  std::uint32_t inverted =
      0;  // tetrahedra without positive orientation (decided exactly), flat ones included
  // The smallest dihedral angle of each tetrahedron, whichever way it is oriented (flat: 0), degrees.
  double min_dihedral_deg = 0;  // over all tetrahedra; 0 where there are none
  std::array<std::uint32_t, 15>
      dihedral_histogram{};  // bin i: [5 i, 5 i + 5) degrees; 70.53 is the most there can be
};
inline constexpr double kHistogramBin_deg = 5.0;

CutReport measure(const TetMesh& mesh);

// The piece of each tetrahedron slot: pieces are numbered from 0 by their lowest tetrahedron; kNone where the
// slot is empty. Returns how many there are through `count` where it is given.
std::vector<std::uint32_t> label_pieces(const TetMesh& mesh, std::uint32_t* count = nullptr);

// Adds the surface between blade lines that follow each other to `surface`, as triangles that stay within
// `tolerance_m` of the ruled quads: what a cut is compared with. Call surface.build() after the last
// addition.
void add_sweep(SweptSurface& surface, std::span<const BladeLine> lines, double tolerance_m);

// How far the cut faces lie from the surface that they were to follow, at their vertices and centroids. In h: the mesh's
// mean edge length, as everywhere, so that the same distance is the same number in fine and in coarse parts.
struct Deviation {
  std::uint32_t samples = 0;
  double max_h = 0;
  double mean_h = 0;
  double max_m = 0;
};
// One pass over the mesh, then O(F log T) for F cut faces and T triangles. No samples where there are no cut
// faces or no triangles. `older`: the cuts that the body came with; a face that lies in these does not count.
Deviation deviation(const TetMesh& mesh, const SweptSurface& surface, const SweptSurface& older = {});
// The cut faces as a surface.
SweptSurface cut_surface(const TetMesh& mesh);

}  // namespace incise::core
