#pragma once

#include <functional>

#include "server/mesh_io/surface.hpp"

namespace incise::mesh_io {

// The zero set of a smooth function, negative inside, within a box, as a closed manifold surface with outward
// triangles: marching tetrahedra over a grid of cells of side `cell` (each cube split into six, after Kuhn),
// which has no ambiguous cases. The box must contain the body with a margin. O(cells).
Surface isosurface(const std::function<double(const core::Vec3&)>& f, const core::Vec3& low,
                   const core::Vec3& high, double cell);

// Makes the triangles of a closed manifold surface near-equilateral with edges of about `edge_length`: splits
// long edges, collapses short ones, flips edges, moves vertices within the surface, and projects them onto
// the zero set of f (Botsch and Kobbelt 2004, "A Remeshing Approach to Multiresolution Modeling", section 4).
// Stays manifold.
void remesh_isotropically(Surface& surface, const std::function<double(const core::Vec3&)>& f,
                          double edge_length, int iterations);

// Splits edges longer than `max_length` at their middle, the longest first, until none is left. The surface
// does not move. A closed manifold surface stays one.
void split_long_edges(Surface& surface, double max_length);

}  // namespace incise::mesh_io
