#pragma once

namespace incise::protocol {

// The vertices of face f (opposite to vertex f) of a tetrahedron, counter-clockwise seen from outside.
inline constexpr int kFaceVertices[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

}  // namespace incise::protocol
