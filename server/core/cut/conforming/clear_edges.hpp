#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "server/core/cut/cut_workspace.hpp"

namespace incise::core {

// Edges that verification has found to be crossed by nothing: five tetrahedra share an edge on average, and what changes around a vertex leaves
// most edges of its tetrahedra as they were. An edge is known while neither end has been moved. Forgets some: each has one place, and
// shares it with others.
class ClearEdges {
 public:
  explicit ClearEdges(const CutWorkspace& workspace) : workspace_(workspace), entries_(kPlaces) {}

  // Knows none.
  void begin(std::uint32_t serial) { serial_ = serial; }
  bool has(VertexId a, VertexId b) const {
    const Entry key = key_of(a, b), &entry = entries_[place_of(key)];
    return entry.serial == serial_ && entry.a == key.a && entry.b == key.b && entry.moves == key.moves;
  }
  void add(VertexId a, VertexId b) {
    const Entry key = key_of(a, b);
    entries_[place_of(key)] = key;
  }

 private:
  static constexpr std::size_t kPlaces = 8192;  // 128 KiB; a batch looks at some hundred edges as a rule

  struct Entry {
    VertexId a = 0, b = 0;    // a < b
    std::uint32_t moves = 0;  // of both
    std::uint32_t serial = 0;
  };
  Entry key_of(VertexId a, VertexId b) const {
    const std::uint32_t moves = workspace_.vertices[a].moves + workspace_.vertices[b].moves;
    return a < b ? Entry{a, b, moves, serial_} : Entry{b, a, moves, serial_};
  }
  static std::size_t place_of(const Entry& key) { return (key.a * 0x9e3779b1u + key.b * 0x85ebca6bu) >> 19; }

  const CutWorkspace& workspace_;
  std::vector<Entry> entries_;
  std::uint32_t serial_ = 0;
};

}  // namespace incise::core
