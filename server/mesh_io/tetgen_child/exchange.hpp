#pragma once

// The two files that tetgen_fill.cpp and incise-tetgen exchange. Native byte order: both run on one machine,
// from one build. They share nothing else.

#include <cstdint>

namespace incise::mesh_io {

inline constexpr char kFillInputMagic[8] = {'I', 'N', 'C', 'S', 'U', 'R', 'F', '1'};
inline constexpr char kFillOutputMagic[8] = {'I', 'N', 'C', 'T', 'E', 'T', 'S', '1'};

// Then: points (3 doubles each), triangles (3 int32), holes (3 doubles), regions (5 doubles: a seed, the
// region's id, the bound of a tetrahedron's volume; -1: none).
struct FillInputHeader {
  char magic[8];
  std::uint64_t points, triangles, holes, regions;
};

// Then: points (3 doubles each), tetrahedra (4 int32), and with has_regions one int32 for each tetrahedron.
struct FillOutputHeader {
  char magic[8];
  std::uint64_t points, tets, has_regions;
};

}  // namespace incise::mesh_io
