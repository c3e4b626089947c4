#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "server/core/mesh/mesh_data.hpp"
#include "server/core/util/archive.hpp"

namespace incise::core {

// The tissue that a blade's line went through: two points of the line, as parts of it from heel to tip, and the vertices nearest to each. As the
// body moves, these take the points along (SweptFollower).
struct LineAnchor {
  static constexpr std::size_t kVertices = 4, kPairs = kVertices * (kVertices - 1) / 2;

  struct Point {
    float part = 0;
    std::array<VertexId, kVertices> near{kNone, kNone, kNone, kNone};  // the nearest first; fewer: kNone
    // By how much each two of these have gone apart since, by what the body has moved alone, m; less than 0: come nearer.
    std::array<float, kPairs> apart_m{};

    friend bool operator==(const Point&, const Point&) = default;
  };
  std::array<Point, 2> points;
  bool is_torn = false;  // two vertices at a point have gone apart farther than tissue is stretched
  friend bool operator==(const LineAnchor&, const LineAnchor&) = default;

  bool is_set() const { return points[0].near[0] != kNone; }
  // Whether all of its vertices are among the first `vertices`.
  bool is_of(std::size_t vertices) const {
    for (const Point& point : points) {
      for (const VertexId v : point.near) {
        if (v != kNone && v >= vertices) return false;
      }
    }
    return true;
  }
  void archive(Archive& io) {
    for (Point& point : points) {
      io(point.part);
      for (VertexId& v : point.near) io(v);
      for (float& m : point.apart_m) io(m);
      io.demand(point.part >= 0 && point.part <= 1, "an anchor beside its line");
    }
  }
};

// The anchors of some lines that get them together, with a byte alone where they have none yet.
template <class Anchors>
void archive_anchors(Archive& io, Anchors& anchors) {
  bool set = false;
  for (const LineAnchor& anchor : anchors) set = set || anchor.is_set();
  io(set);
  if (!set) return;
  for (LineAnchor& anchor : anchors) anchor.archive(io);
}

}  // namespace incise::core
