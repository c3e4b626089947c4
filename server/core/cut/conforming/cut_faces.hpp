#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"
#include "server/core/geometry/box.hpp"

namespace incise::core {

// The faces that all strokes have opened, found by place. The boundary grid's cells are wide and hold what is stale; here those near a point are listed
// by cells of h, when something in a cell is first asked for.
class CutFaces {
 public:
  explicit CutFaces(const CutContext& cut) : cut_(cut), cells_(kCells) { lately_.fill(kNone); }

  // The mesh has changed: forgets all lists. O(1).
  void begin() { ++serial_; }
  // Whether one is within `reach` of p, kFilmReach_h h at most. O(faces near p), and the boundary there when the cell is new.
  bool is_within(const Vec3& p, double reach);

 private:
  struct Face {
    Box around;
    Vec3 a, b, c;
  };
  struct Cell {
    std::uint64_t serial = 0;
    std::array<std::int64_t, 3> at{};
    std::vector<Face> faces;
  };
  // Each place has its own; one that another place takes is listed again.
  static constexpr std::size_t kCells = 128, kLately = 1024;

  void list(Cell& cell);

  const CutContext& cut_;
  std::uint64_t serial_ = 1;
  std::vector<Cell> cells_;
  std::array<TetId, kLately> lately_{};  // scratch: by number, the last one that was met
};

}  // namespace incise::core
