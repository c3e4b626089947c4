#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"

namespace incise::core {

// The surface crosses the edge (a, b) with a < b.
struct Crossing {
  double nearness;  // distance of the crossing from the nearer end, by the edge's length: nearest go first
  double at;        // the crossing is at a + at (b - a)
  VertexId a, b;
  TetId tet;               // one that had the edge
  std::uint32_t triangle;  // of the surface
  std::uint32_t next;      // in the chain of crossings at vertex a
  std::uint32_t batch;     // that found it
  bool done;
  bool inside;  // clearly amid the triangle, of what was swept last
};

// The crossings that wait: search and verification find them, the crossing stage deals with them.
class Crossings {
 public:
  explicit Crossings(CutContext& cut) : cut_(cut) {}

  void clear() { list_.clear(); }
  std::size_t size() const { return list_.size(); }
  Crossing& operator[](std::size_t i) { return list_[i]; }

  // An edge is found once in a collection. One that begins with a batch counts those that wait as found.
  void begin_batch();
  void begin_collection() { collection_ = cut_.workspace.next_serial(); }
  // `at`: at a + at (b - a).
  void add(VertexId a, VertexId b, TetId t, std::uint32_t triangle, double at, bool inside = false);
  // Whether this batch has found the edge to be crossed clearly amid a triangle.
  bool is_inside(VertexId a, VertexId b) const;
  void drop_done();

  void clinging(std::vector<VertexId>& out) const;
  void archive(Archive& io);

 private:
  std::uint32_t find(VertexId a, VertexId b) const;

  CutContext& cut_;
  std::vector<Crossing> list_;
  std::uint32_t collection_ = 0;  // its serial
};

}  // namespace incise::core
