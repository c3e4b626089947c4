#pragma once

#include <string>
#include <vector>

#include "server/core/mesh/mesh_data.hpp"
#include "server/mesh_io/surface.hpp"

namespace incise::mesh_io {

// A surface that bounds a volume: closed, manifold along its edges, oriented outwards, free of intersections.
struct ClosedSurface {
  Surface surface;
  // A point inside each cavity, and inside each part that has a region of its own (a shell within a shell).
  std::vector<core::Vec3> holes;
  struct Region {
    core::Vec3 seed;
    std::int32_t id;
  };
  std::vector<Region> regions;  // empty if everything is region 0
  double volume = 0;            // enclosed, m^3, without the cavities
};

// Makes sure that a surface can be filled with tetrahedra, or says why not. Fixes orientation: triangles are
// turned to agree with their neighbours, shells that are inside out are turned as a whole; a line in
// `warnings` says so. A shell inside another one is a cavity if the file orients it opposite to the outer one,
// else an inclusion: tissue with its own region, counted from 1.
//
// Throws MeshError, naming the first place and the number of them, for: a triangle with a vertex twice or
// without area, two triangles with the same vertices, edges of one triangle (open) or of more than two
// (non-manifold), a surface with one side only, triangles that cross or touch. O(n log n).
ClosedSurface check_surface(Surface surface, const std::string& file, std::vector<std::string>& warnings);

}  // namespace incise::mesh_io
