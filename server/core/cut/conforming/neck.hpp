#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "server/core/cut/conforming/cut_context.hpp"
#include "server/core/cut/conforming/tissue_grid.hpp"

namespace incise::core {

// The tissue around a face that alone holds two parts together, as points on a grid, and the ways between them that the swept surfaces block, those of
// older strokes as well, and the boundary. Says what the mesh cannot: whether the parts hang together by more than that face would have it. A lobe of the
// body as it grew hangs together by a face at the skin as well.
class Neck {
 public:
  Neck(CutContext& cut, TissueGrid& grid) : cut_(cut), mesh_(cut.mesh), grid_(grid), pass_(cut.workspace) {}

  enum class Answer { kApart, kTogether, kUnknown };
  // Whether the surfaces part what lies on the two sides of a face, which hang together in no other way than through faces that are about
  // to open. Looks around the face. Some 0.5 ms, up to 3 where a hand has been at it for long. kUnknown: the face is so large that too little would be seen
  // of what is around it.
  Answer judge(HalfFace h);
  // The same where one of the sides is known to its end: `part`, on the other side of h. Looks at all of it, some 0.1 ms for a cubic h. kUnknown: it is too
  // large for that, or there is next to nothing of one of the sides.
  Answer judge(HalfFace h, std::span<const TetId> part);

 private:
  // How many points lie on each side, and between other faces that are about to open.
  using Counts = std::array<std::size_t, 3>;

  bool lay_out_finely(const Box& box);
  void lay_out(const Box& box, double step_m);
  std::size_t fill(TetId from, std::uint8_t side);
  std::size_t fill(std::span<const TetId> tets, std::uint8_t side);
  std::size_t fill_between();
  void take_beyond(TetId t, bool through);
  void leave_out_thin(Counts& counts);
  double shared(const Counts& counts);
  Counts follow(std::size_t first);

  CutContext& cut_;
  const TetMesh& mesh_;
  TissueGrid& grid_;
  TetPass pass_;
  std::vector<TetId> filled_;       // the tetrahedra whose points are laid out
  std::vector<TetId> tets_;         // scratch
  std::vector<std::size_t> queue_;  // scratch
};

}  // namespace incise::core
