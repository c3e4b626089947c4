#pragma once

#include <optional>

#include "server/core/blade.hpp"
#include "server/core/boundary_grid.hpp"
#include "server/core/tet_mesh.hpp"
#include "server/haptics/material.hpp"

namespace incise::haptics {

// How a blade's edge lies in the tissue at one moment, with the materials summed along it.
struct Engagement {
  double length_m = 0;    // of the edge inside
  double uncut_m = 0;     // of that, in tissue that no cut has opened along the edge
  double fracture_n = 0;  // toughness times uncut length: the work of cutting on, for each metre of motion
  double friction_n_s_m = 0;  // friction times length
  double stiffness_n_m = 0;   // of the tissue that the edge presses on
  double puncture_n = 0;      // the largest
  double middle = 0;          // of what is inside: a parameter of the line, 0 at the heel, 1 at the tip
  // The ends of the longest stretch inside, as parameters.
  double from = 0, to = 0;
};

// Finds what of the edge is inside: where it crosses the boundary from the grid, what lies between by walking through
// the tetrahedra. Where two cut faces still touch and the edge lies between them (within 0.15 h), the tissue counts
// as cut, and its length is that a little beside it. O(tetrahedra along the edge + boundary in the grid cells along it); at most kMostCrossings crossings and
// kMostSteps tetrahedra a stretch count, what lies beyond them is passed over.
Engagement probe(const core::TetMesh& mesh, const core::BoundaryGrid& grid, const Materials& materials,
                 const core::BladeLine& line) noexcept;
inline constexpr int kMostCrossings = 64;
inline constexpr std::uint32_t kMostSteps = 4096;

// A point on the boundary that the mesh had before it was cut.
struct SurfacePoint {
  core::Vec3 point;   // m
  core::Vec3 normal;  // unit, out of the tissue
  double distance_m;
};

// The nearest such point to p within `radius` (m, at most two grid cells are sensible). Cut faces do not count: a
// blade in its own slit is not outside. O(boundary in the cells of a box of that size).
std::optional<SurfacePoint> nearest_surface(const core::TetMesh& mesh, const core::BoundaryGrid& grid,
                                            const core::Vec3& p, double radius) noexcept;

}  // namespace incise::haptics
