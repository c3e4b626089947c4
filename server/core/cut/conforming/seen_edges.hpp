#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "server/core/cut/cut_workspace.hpp"

namespace incise::core {

// Edges that verification has looked at: five tetrahedra share an edge on average, and what changes around a vertex leaves most edges of its
// tetrahedra as they were. One that nothing crosses is known for the batch, another one for the round, both while neither end has been
// moved. Forgets some: each has one place, and shares it with others.
class SeenEdges {
 public:
  enum class Seen { kNot, kClear, kCrossed };

  explicit SeenEdges(const CutWorkspace& workspace) : workspace_(workspace), entries_(kPlaces) {}

  // Knows none. Batches and rounds have numbers of their own: the workspace's serials.
  void begin_batch(std::uint32_t serial) { batch_ = serial; }
  // Knows those that nothing crosses.
  void begin_round(std::uint32_t serial) { round_ = serial; }
  Seen look_up(VertexId a, VertexId b) const {
    const Entry key = key_of(a, b), &entry = entries_[place_of(key)];
    if (entry.a != key.a || entry.b != key.b || entry.moves != key.moves) return Seen::kNot;
    return entry.serial == batch_ ? Seen::kClear : entry.serial == round_ ? Seen::kCrossed : Seen::kNot;
  }
  void add(VertexId a, VertexId b, bool clear) {
    Entry key = key_of(a, b);
    key.serial = clear ? batch_ : round_;
    entries_[place_of(key)] = key;
  }

 private:
  static constexpr std::size_t kPlaces = 8192;  // 128 KiB; a batch looks at some hundred edges as a rule

  struct Entry {
    VertexId a = 0, b = 0;     // a < b
    std::uint32_t moves = 0;   // of both
    std::uint32_t serial = 0;  // of the batch in which it is clear, or of the round in which it is not
  };
  Entry key_of(VertexId a, VertexId b) const {
    const std::uint32_t moves = workspace_.vertices[a].moves + workspace_.vertices[b].moves;
    return a < b ? Entry{a, b, moves, 0} : Entry{b, a, moves, 0};
  }
  static std::size_t place_of(const Entry& key) { return (key.a * 0x9e3779b1u + key.b * 0x85ebca6bu) >> 19; }

  const CutWorkspace& workspace_;
  std::vector<Entry> entries_;
  std::uint32_t batch_ = 0, round_ = 0;
};

}  // namespace incise::core
